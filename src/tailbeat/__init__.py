"""tailbeat: from bench recordings of a soft robotic fish to a learned controller that swims."""

import os
import sys
from importlib.metadata import PackageNotFoundError, version

# The engine picks its GL library when it is first imported; on Linux EGL needs no screen. A missing
# library is met in fish/render.py, and the interactive viewer brings its own.
if sys.platform == "linux":
    os.environ.setdefault("MUJOCO_GL", "egl")

try:
    __version__ = version("tailbeat")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0+source"
