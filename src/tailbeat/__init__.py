"""tailbeat: from bench recordings of a soft robotic fish to a learned controller that swims."""

import ctypes
import os
import sys
from importlib.metadata import PackageNotFoundError, version


def _choose_gl() -> None:
    """On Linux, EGL where it is: it needs no screen. The engine chooses when first imported, and
    with EGL asked for but missing that import fails. The interactive viewer brings its own."""
    if sys.platform != "linux" or "MUJOCO_GL" in os.environ:
        return
    try:
        ctypes.CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        if "DISPLAY" not in os.environ and "WAYLAND_DISPLAY" not in os.environ:
            os.environ["MUJOCO_GL"] = "disable"


_choose_gl()

try:
    __version__ = version("tailbeat")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0+source"
