"""How the plant's functions are compiled."""

from numba import njit

# A division by zero gives inf or NaN, as numpy's does. Numba's own way is to raise, which ends a
# parallel lane without a word: a fish that diverged kept samples that were never written.
compiled = njit(cache=True, error_model="numpy")
compiled_parallel = njit(cache=True, error_model="numpy", parallel=True)
