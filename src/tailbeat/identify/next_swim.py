"""What a swim would tell about a prediction, from the draws of a posterior.

The draws swim every candidate and every goal. Draws that differ in a goal, such as the speed of a
turn, and in what a candidate would show tell how much the candidate would tell. To first order this
is a linear regression of the goals on what is seen, with the camera's error and the twin's
discrepancy as noise (the linear Bayes estimate). Nothing is recorded or fitted.

The law of the water errs in its own way for every kind of swim: fitted to one kind, a twin may be
wrong about another, however much the numbers have in common. So a swim of another kind than the
goal's tells less (`OTHER`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.twin import compile_twin
from tailbeat.identify.bands import Discrepancy, Drawn, noise
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.gait import Gait, Track
from tailbeat.identify.launch import launch_of
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.protocol import RATE, fluid_runs, limits
from tailbeat.identify.quantities import UNITS
from tailbeat.identify.runs import Run
from tailbeat.recording import Recording

Array = NDArray[np.float64]
CALM = 120.0  # s of waiting for still water before each swim, chosen
SEEN = np.array([0.002, 0.01, 1.0, 0.5])  # error of one recording: m/s, m, deg, deg/s; chosen
GOAL = np.array([0.0, 0.0, 10.0, 1.0])  # added to a goal's size: m/s, m, deg, deg/s; chosen
# Error of a swim of another kind than the goal's, over its own size. Chosen: twins of nine swims
# were 15 to 30 % off in headings of a kind that they were not fitted to.
OTHER = np.array([0.1, 0.1, 0.25, 0.25])


@dataclass(frozen=True, eq=False)
class SwimRecording:
    """A swim that could be recorded: the lab time in `minutes`, and what it would show of each draw
    (n, s), in units of its error."""

    minutes: float
    shown: Array
    kind: str = "swim"


def commands(fish: Fish) -> dict[str, Recording]:
    """Every swim of the protocol, and every check swim. Raises BadInput for a crank."""
    limit = limits(fish)
    return {**fluid_runs(fish, limit), **manoeuvres(fish, limit), **check_swims(fish, limit)}


def as_played(commands: Mapping[str, Recording], fish: Fish) -> dict[str, Run]:
    """Commands as runs whose motor moves as the fish's servo follows them; their tracks are only
    clocks."""
    twin = compile_twin(fish)
    step = twin.model.opt.timestep
    every, nan = max(round(1 / RATE / step), 1), float("nan")
    swims = swim(
        [twin] * len(commands),
        [Start.at_rest()] * len(commands),
        [np.repeat(one.columns["command_rad"], every) for one in commands.values()],
        every,
    )
    gait = Gait(nan, nan, nan, complex(nan), None, nan)
    found = {}
    for (name, one), done in zip(commands.items(), swims, strict=True):
        track = Track(one.time, np.zeros((one.time.size, 3)))
        motor = done.qpos[: one.time.size, twin.motor]
        launch = launch_of(one, fish)
        found[name] = Run(one.name, track, gait, motor, launch is None, launch)
    return found


def of_kind(names: Iterable[str], fish: Fish, kind: str) -> list[str]:
    """The swims of a kind, the end of their names; of none, those with a steady beat from rest."""
    steady = set(fluid_runs(fish, limits(fish)))
    return [name for name in names if name.endswith(kind) and (kind or name in steady)]


def scaled(swims: Sequence[Drawn], names: Sequence[str]) -> Array:
    """What each draw predicts of these quantities (n, g), over its size in the fish and `GOAL`."""
    columns = [list(UNITS).index(name) for name in names]
    scales = [np.abs(one.centre) + GOAL for one in swims]
    return np.concatenate(
        [(one.predicted / s)[:, columns] for one, s in zip(swims, scales, strict=True)], axis=1
    )


def recording_of(swim: Drawn, known: Discrepancy | None, own_kind: bool = True) -> SwimRecording:
    """What a recording of the swim would tell; less if it is not of the goal's `own_kind`."""
    apart = 0.0 if own_kind else OTHER * np.abs(swim.centre)
    error = np.sqrt(SEEN**2 + noise(swim, known) ** 2 + apart**2)
    minutes = float((swim.run.track.time[-1] + CALM) / 60)
    return SwimRecording(minutes, np.asarray(swim.predicted / error))


def spread_after(goals: Array, seen: Sequence[Array]) -> float:
    """Root mean square deviation of the goals (n, g) over the draws that would be left after seeing
    `seen`, arrays (n, s) in units of their errors."""
    good = np.isfinite(goals).all(axis=1)
    for one in seen:
        good &= np.isfinite(one).all(axis=1)
    away = goals[good] - goals[good].mean(axis=0)
    own = np.asarray(away.T @ away) / len(away)
    if seen:
        shown = np.concatenate([one[good] - one[good].mean(axis=0) for one in seen], axis=1)
        across = shown.T @ away / len(away)
        noisy = shown.T @ shown / len(away) + np.eye(shown.shape[1])
        own = own - across.T @ np.linalg.solve(noisy, across)
    return float(np.sqrt(max(np.trace(own), 0.0) / len(own)))
