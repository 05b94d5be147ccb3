"""How the plant's functions are compiled."""

import hashlib
from contextlib import suppress
from pathlib import Path

from numba import njit


def forget_older(folder: Path) -> None:
    """Remove compiled functions that numba keeps for another state of a room's source.

    Numba looks at the file of a function only. If another file changes that the function calls,
    it goes on with the old one.
    """
    sources = sorted(folder.glob("*.py"))
    state = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    stamp = folder / "__pycache__" / "numba-source"
    with suppress(OSError):  # a folder that cannot be written keeps nothing either
        if stamp.exists() and stamp.read_text() == state:
            return
        for kept in stamp.parent.glob("*.nbi"):
            kept.unlink(missing_ok=True)
        stamp.write_text(state)


forget_older(Path(__file__).parent)

# A division by zero gives inf or NaN, as in numpy. By default numba raises an error, which ends a
# parallel lane silently: a fish that diverged then kept samples that were never written.
compiled = njit(cache=True, error_model="numpy")
compiled_parallel = njit(cache=True, error_model="numpy", parallel=True)
