"""tailbeat: from bench recordings of a soft robotic fish to a learned controller that swims.

`import tailbeat as tb` imports nothing else. Each public name is imported when it is first used.
If a package is missing, the error names the extra to install. docs/start/python.md lists the names.
"""

import ctypes
import os
import sys
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.control.policy import decide as decide
    from tailbeat.control.policy import load_policy as load_policy
    from tailbeat.env.reward import Reward as Reward
    from tailbeat.env.task import Settings as Settings
    from tailbeat.env.task import Task as Task
    from tailbeat.env.task import settings_for as settings_for
    from tailbeat.env.vector_env import FishEnv as FishEnv
    from tailbeat.env.vector_env import FishVectorEnv as FishVectorEnv
    from tailbeat.evaluate.reach import in_pool as in_pool
    from tailbeat.evaluate.reach import in_twin as in_twin
    from tailbeat.evaluate.reach import reach as reach
    from tailbeat.files import BadInput as BadInput
    from tailbeat.fish.description import Fish as Fish
    from tailbeat.fish.simulate import simulate as simulate
    from tailbeat.fish.store import load_fish as load_fish
    from tailbeat.fish.store import new_fish as new_fish
    from tailbeat.fish.store import with_values as with_values
    from tailbeat.fish.twin import compile_twin as compile_twin
    from tailbeat.identify.job import identify_fluid as identify_fluid
    from tailbeat.identify.predict import predict as predict
    from tailbeat.identify.runs import as_run as as_run
    from tailbeat.identify.servo import as_bench as as_bench
    from tailbeat.identify.servo_job import identify_servo as identify_servo
    from tailbeat.identify.tail import identify_tail as identify_tail
    from tailbeat.recording import Recording as Recording
    from tailbeat.recording import read_recording as read_recording
    from tailbeat.recording import write_recording as write_recording
    from tailbeat.train.config import RunConfig as RunConfig
    from tailbeat.train.recipes import recipe_of as recipe_of
    from tailbeat.train.train import train as train_policy  # noqa: F401  (`train` is a room)

# Where each public name is defined: "module:name".
_HOMES = {
    "BadInput": "files:BadInput",
    "Fish": "fish.description:Fish",
    "FishEnv": "env.vector_env:FishEnv",
    "FishVectorEnv": "env.vector_env:FishVectorEnv",
    "Recording": "recording:Recording",
    "Reward": "env.reward:Reward",
    "RunConfig": "train.config:RunConfig",
    "Settings": "env.task:Settings",
    "Task": "env.task:Task",
    "as_bench": "identify.servo:as_bench",
    "as_run": "identify.runs:as_run",
    "compile_twin": "fish.twin:compile_twin",
    "decide": "control.policy:decide",
    "identify_fluid": "identify.job:identify_fluid",
    "identify_servo": "identify.servo_job:identify_servo",
    "identify_tail": "identify.tail:identify_tail",
    "in_pool": "evaluate.reach:in_pool",
    "in_twin": "evaluate.reach:in_twin",
    "load_fish": "fish.store:load_fish",
    "load_policy": "control.policy:load_policy",
    "new_fish": "fish.store:new_fish",
    "predict": "identify.predict:predict",
    "reach": "evaluate.reach:reach",
    "read_recording": "recording:read_recording",
    "recipe_of": "train.recipes:recipe_of",
    "settings_for": "env.task:settings_for",
    "simulate": "fish.simulate:simulate",
    "train_policy": "train.train:train",
    "with_values": "fish.store:with_values",
    "write_recording": "recording:write_recording",
}
__all__ = ["__version__", *_HOMES]
__version__: str


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # so that a type checker refuses names that are not public

    def __getattr__(name: str) -> object:
        if name == "__version__":
            value = _version()
        elif name in _HOMES:
            value = _public(name)
        else:
            raise AttributeError(f"module 'tailbeat' has no attribute {name!r}")
        globals()[name] = value
        return value


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("tailbeat")
    except PackageNotFoundError:  # run from a source tree that was not installed
        return "0+source"


def _public(name: str) -> object:
    module, _, attribute = _HOMES[name].partition(":")
    try:
        return getattr(import_module(f"tailbeat.{module}"), attribute)
    except ModuleNotFoundError as error:
        files = import_module("tailbeat.files")
        if error.name not in files.EXTRA_OF:
            raise
        raise ModuleNotFoundError(
            f"tailbeat.{name} needs {files.missing(error.name)}", name=error.name
        ) from error


def _choose_gl() -> None:
    """On Linux, choose EGL for rendering if it is installed: it needs no screen. MuJoCo reads the
    choice when it is imported first, and fails if EGL is chosen but missing. The interactive
    viewer makes its own context."""
    if sys.platform != "linux" or "MUJOCO_GL" in os.environ:
        return
    try:
        ctypes.CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        if "DISPLAY" not in os.environ and "WAYLAND_DISPLAY" not in os.environ:
            os.environ["MUJOCO_GL"] = "disable"


def _register(gymnasium: ModuleType) -> None:
    """Make `gymnasium.make("tailbeat/Reach-v0")` and `make_vec` known."""
    gymnasium.register(
        "tailbeat/Reach-v0",
        entry_point="tailbeat.env.registered:reach",
        vector_entry_point="tailbeat.env.registered:reach_vector",
    )


class _WhenGymnasiumIsImported:
    """Registers the environments when gymnasium is imported. Gymnasium no longer has entry points
    for plugins, and `import tailbeat` must not wait for an import of gymnasium."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Gymnasium's own spec. After loading, its loader registers our environments."""
        found = PathFinder.find_spec(name) if name == "gymnasium" else None
        if found is None or found.loader is None:
            return None
        load = found.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            load(module)
            _register(module)

        found.loader.exec_module = exec_module  # type: ignore[method-assign]
        return found


_choose_gl()
if "gymnasium" in sys.modules:
    _register(sys.modules["gymnasium"])
else:
    sys.meta_path.insert(0, _WhenGymnasiumIsImported)
