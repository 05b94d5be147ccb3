"""All benchmarks of this machine: step, environment, updates, camera, control loop."""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

from tailbeat.benchmarks import step
from tailbeat.benchmarks.step import PoolRow, StepRow

if TYPE_CHECKING:  # they need extras
    from tailbeat.benchmarks.environment import EnvironmentRow, PeerRow
    from tailbeat.benchmarks.messy import MessyRow
    from tailbeat.benchmarks.physics import PhysicsRow
    from tailbeat.benchmarks.punctuality import PunctualityRow
    from tailbeat.benchmarks.sweeps import MoreCoresRow, SweepRow
    from tailbeat.benchmarks.update import UpdateRow
    from tailbeat.benchmarks.vision import LiveRow, VisionRow


@dataclass(frozen=True)
class VisionBenchmark:
    """Vision: a row per condition of the pictures, and the real processes."""

    pictures: "tuple[VisionRow, ...]"
    live: "LiveRow"


@dataclass(frozen=True)
class Benchmark:
    """Speeds on a `machine`: step of each fish, pool, vision, `messy` labs, ways to step the
    physics, environment by number of fish and compared with SB3's (`peers`), training updates, the
    robot's `loop` alone and beside busy programs; or a `sweep` and what `more_cores` would give.
    Empty or None where not measured, or where an extra is missing."""

    machine: str
    fish: tuple[StepRow, ...]
    pool: tuple[PoolRow, ...]
    vision: VisionBenchmark | None = None
    messy: "tuple[MessyRow, ...]" = ()
    physics: "tuple[PhysicsRow, ...]" = ()
    env: "tuple[EnvironmentRow, ...]" = ()
    peers: "PeerRow | None" = None
    update: "tuple[UpdateRow, ...]" = ()
    loop: "tuple[PunctualityRow, ...]" = ()
    sweep: "SweepRow | None" = None
    more_cores: "tuple[MoreCoresRow, ...]" = ()


def benchmark(env: bool = True) -> Benchmark:
    """Measure this machine; environment and updates only if `env` is set."""
    found = Benchmark(step.machine(), step.step_bench(), step.pool_bench())
    if find_spec("cv2") and find_spec("pyapriltags"):
        found = _with_vision(found)
    if env and find_spec("stable_baselines3"):
        found = _with_learning(found)
    return _with_loop(found) if find_spec("serial") and find_spec("mcap") else found


def sweep_benchmark() -> Benchmark:
    """Measure a sweep on this machine, and nothing else."""
    from tailbeat.benchmarks.sweeps import more_cores, sweep_bench

    row = sweep_bench()
    return Benchmark(step.machine(), (), (), sweep=row, more_cores=more_cores(row))


def _with_loop(found: Benchmark) -> Benchmark:
    from tailbeat.benchmarks.punctuality import punctuality_bench

    return replace(found, loop=punctuality_bench())


def _with_vision(found: Benchmark) -> Benchmark:
    from tailbeat.benchmarks.vision import live_bench, vision_bench

    return replace(found, vision=VisionBenchmark(vision_bench(), live_bench()))


def _with_learning(found: Benchmark) -> Benchmark:
    from tailbeat.benchmarks.environment import env_bench
    from tailbeat.benchmarks.messy import messy_bench
    from tailbeat.benchmarks.physics import physics_bench
    from tailbeat.benchmarks.update import update_bench

    found, physics = replace(found, messy=messy_bench()), physics_bench()
    env, peers = env_bench()
    return replace(found, physics=physics, env=env, peers=peers, update=update_bench())
