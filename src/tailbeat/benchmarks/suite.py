"""All benchmarks of this machine: step, environment, updates, camera."""

from importlib.util import find_spec
from typing import Any

from tailbeat.benchmarks import step


def benchmark(env: bool = True) -> dict[str, Any]:
    """Speed on this machine; with `env`, of environment and updates, where the train extra is; of
    the camera's side where the robot extra is."""
    result = step.bench()
    if find_spec("cv2") is not None and find_spec("pyapriltags") is not None:
        from tailbeat.benchmarks.vision import live_bench, vision_bench  # needs the extra

        result["vision"] = {"pictures": vision_bench(), "live": [live_bench()]}
    if env and find_spec("stable_baselines3") is not None:
        from tailbeat.benchmarks.environment import env_bench  # needs the extra
        from tailbeat.benchmarks.physics import physics_bench  # and so does the environment
        from tailbeat.benchmarks.update import update_bench

        result["physics"] = physics_bench()
        result["env"] = env_bench()
        result["update"] = update_bench()
    return result
