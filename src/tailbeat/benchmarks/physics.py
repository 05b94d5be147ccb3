"""Cost and error of a control step of the physics, for several ways to step.

Seven gaits of 10 s, some turning, up to the generator's largest first harmonic at its ceiling,
compared with the same fish at 0.1 ms. Costs are of one core with 16 fish.
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, Swim, quiet_engine, swim
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import Options, Twin, compile_twin

Array = NDArray[np.float64]
SECONDS = 10.0
COUNT = 16  # fish per timing
# frequency [Hz], amplitude and centre [rad] of each gait
GAITS = (
    (1.0, 0.5, 0.0), (2.0, 0.7, 0.0), (3.0, 0.7, 0.3), (4.0, 0.5, -0.2), (4.0, 1.0, 0.0),
    (2.0, 1.0, 0.4), (3.0, 1.0, 0.0),
)  # fmt: skip


@dataclass(frozen=True)
class Way:
    """A way to step: integrator, step [ms], and differences from the fish as described."""

    integrator: str
    step_ms: float
    root: str = "planar"
    tendons: str = "tied"


@dataclass(frozen=True, kw_only=True)
class PhysicsRow(Way):
    """A way to step with its results: control steps per second on one core, and after 10 s the
    largest errors of the mean speed [%] and of the heading [deg]; None where not measured."""

    control_steps_per_s_core: float
    speed_error_percent: float | None = None
    heading_error_deg: float | None = None
    note: str = ""


REFERENCE = Way("Euler", 0.1)
WAYS = (
    *(Way("implicit", step) for step in (1.0, 2.0, 4.0, 5.0)),
    *(Way("implicitfast", step) for step in (1.0, 2.0, 4.0)),
    *(Way("discrete", step) for step in (1.0, 2.0, 4.0)),
    *(Way("Euler", step) for step in (1.0, 2.0, 4.0, 5.0, 10.0)),
    Way("Euler", 4.0, root="free"),
    Way("Euler", 4.0, tendons="springs of 20 kN/m"),
)


def physics_bench(name: str = "pulley-fish-pool") -> tuple[PhysicsRow, ...]:
    """Measure control steps per second and core, and errors after 10 s, of every way."""
    fish = load_fish(name)
    truth = _swims(_stepped(fish, REFERENCE))
    return tuple(_row(fish, way, truth) for way in WAYS)


def _stepped(fish: Fish, way: Way) -> Twin:
    """The twin with a way to step. Not validated, because the engine has ways that we do not
    offer."""
    simulation = fish.simulation.model_copy(
        update={"step": 1e-3 * way.step_ms, "integrator": way.integrator}
    )
    changed: dict[str, Any] = {"simulation": simulation}
    if way.tendons != "tied":
        springs = {"stiffness": 2e4, "damping": 20.0, "two_way": True}
        changed["tendons"] = fish.tendons.model_copy(update=springs)
    root: Any = way.root
    return compile_twin(fish.model_copy(update=changed), Options(root=root))


def _swims(twin: Twin) -> list[Swim]:
    """Swim all gaits, one sample per control period; commands change with the period, as in
    control."""
    every = round(PERIOD / twin.model.opt.timestep)
    clock = PERIOD * np.arange(round(SECONDS / PERIOD))
    commands = [
        np.repeat(np.minimum(clock, 1) * (c + a * np.sin(2 * np.pi * f * clock)), every)
        for f, a, c in GAITS
    ]
    return swim([twin] * len(GAITS), [Start.at_rest()] * len(GAITS), commands, every)


def _row(fish: Fish, way: Way, truth: list[Swim]) -> PhysicsRow:
    twin = _stepped(fish, way)
    row = PhysicsRow(**vars(way), control_steps_per_s_core=_rate(twin))
    if way.root == "free":
        return replace(row, note="only the cost")
    done = _swims(twin)
    if any(one.diverged for one in done):
        return replace(row, note="diverged")
    pairs = list(zip(done, truth, strict=True))
    speed = max(abs(_length(a) / _length(b) - 1) for a, b in pairs)
    heading = max(abs(float(a.qpos[-1, 2] - b.qpos[-1, 2])) for a, b in pairs)
    turned = float(np.degrees(heading))
    return replace(row, speed_error_percent=100 * speed, heading_error_deg=turned)


def _length(done: Swim) -> float:
    return float(np.linalg.norm(np.diff(done.qpos[:, :2], axis=0), axis=1).sum())


def _rate(twin: Twin, rounds: int = 50, repeats: int = 4) -> float:
    """Control steps per second of one core."""
    pool = batch.Batch(twin.model, COUNT, nthread=1, persistent=True)
    control, substeps = pool.bind("ctrl"), round(PERIOD / twin.model.opt.timestep)
    best = float("inf")
    with quiet_engine():
        for _ in range(repeats):
            began = time.perf_counter()
            for step in range(rounds):
                control[:, 0] = 0.6 * np.sin(0.25 * step + np.arange(COUNT))
                pool.step(nstep=substeps)
            best = min(best, time.perf_counter() - began)
    return rounds * COUNT / best
