"""How the plant's functions are compiled."""

from numba import njit

# A division by zero gives inf or NaN, as in numpy. By default numba raises an error, which ends a
# parallel lane silently: a fish that diverged then kept samples that were never written.
compiled = njit(cache=True, error_model="numpy")
compiled_parallel = njit(cache=True, error_model="numpy", parallel=True)
