"""The end of a search: least squares from a good candidate, every iteration kept."""

import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tailbeat.files import new_file
from tailbeat.identify.space import (
    Array,
    Edges,
    Parameter,
    Progress,
    Residuals,
    bounds,
    cost,
    sensitivity,
)

ENOUGH = 2e-4  # relative gain below which the polish stops


@dataclass(frozen=True)
class Polished:
    """One part of a polish, kept in a file beside the search's `checkpoint` (None: not kept)."""

    checkpoint: Path | None
    part: str

    @property
    def _path(self) -> Path | None:
        kept = self.checkpoint
        return None if kept is None else kept.with_name(f"{kept.name}-polish{self.part}")

    def read(self, z: Array) -> "_State":
        """Where the iterations led from `z`."""
        if self._path is None or not self._path.is_file():
            return _State(0, z)
        state: _State = pickle.loads(self._path.read_bytes())
        return state

    def write(self, state: "_State") -> None:
        """Keep an iteration's result."""
        if self._path is not None:
            with new_file(self._path, overwrite=True) as path:
                path.write_bytes(pickle.dumps(state))


@dataclass(frozen=True, eq=False)
class _State:
    """A polish after `done` iterations: `z` (p,), and from the last one the residuals `found` (r,)
    and their `slope` (r, p), which was updated `secants` times; None: to be computed."""

    done: int
    z: Array
    found: Array | None = None
    slope: Array | None = None
    secants: int = 0


NOT_KEPT = Polished(None, "")
DAMPINGS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
SECANTS = 3  # steps on updated Jacobians in a row, chosen


def polish(
    residuals: Residuals,
    space: tuple[Parameter, ...],
    z: Array,
    iterations: int,
    progress: Progress = lambda stage, share, best: None,
    central: bool = False,
    begun: Polished = NOT_KEPT,
) -> Array:
    """Levenberg-Marquardt from `z` (p,), with the prior as extra residuals; several dampings per
    batched call. Returns the best z (p,). `begun` keeps every iteration.

    Between two Jacobians by finite differences are up to `SECANTS` that are updated from the last
    step (Broyden 1965), which cost no swims.
    """
    # `mujoco.minimize.least_squares` was tried: costs within 0.15 % of these on two servos, with a
    # third of the candidates; on one seed of the tests' curve it took 103 calls instead of 14.
    state = begun.read(z)
    while state.done < iterations:
        state = _iterated(residuals, space, state, central, iterations, progress)
        begun.write(state)
    return state.z


def _iterated(
    residuals: Residuals,
    space: tuple[Parameter, ...],
    state: _State,
    central: bool,
    iterations: int,
    progress: Progress,
) -> _State:
    """One iteration; after the last one, or where nothing improves, `done` is `iterations`."""
    z, found, slope, edges = state.z, state.found, state.slope, bounds(space)
    if found is None or slope is None:
        found, slope = sensitivity(residuals, z, central, edges=edges)
    best = float(cost(found[None], z[None])[0])
    trials = np.array([_moved(found, slope, z, damping, edges) for damping in DAMPINGS])
    tried = residuals(trials)
    costs = cost(tried, trials)
    last = int(np.argmin(costs))
    progress("polish", (state.done + 1) / iterations, min(best, float(costs[last])))
    if costs[last] > best * (1 - ENOUGH):
        return _State(state.done + 1 if state.secants else iterations, z)
    if state.secants == SECANTS:
        return _State(state.done + 1, trials[last])
    moved, change = trials[last] - z, tried[last] - found
    slope = slope + np.outer(change - slope @ moved, moved) / (moved @ moved)
    return _State(state.done + 1, trials[last], tried[last], slope, state.secants + 1)


def _moved(found: Array, slope: Array, z: Array, damping: float, edges: Edges) -> Array:
    """z + d, with (J'J + 1 + damping diag) d = -(J'r + z); the prior is one residual z each.

    A number that would leave its range stops at its edge, and the others are solved for again.
    Steps that were cut at the edge instead led nowhere: with a third of the numbers there, the
    polish stood still after four of thirty iterations.
    """
    normal = slope.T @ slope + np.eye(z.size)
    pull, damped = -(slope.T @ found + z), normal + damping * np.diag(np.diag(normal))
    low, high = edges
    step, free = np.zeros(z.size), np.ones(z.size, bool)
    while free.any():
        rest = pull[free] - damped[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], rest)
        out = free & ((z + step < low) | (z + step > high))
        if not out.any():
            break
        step[out] = np.clip(z + step, low, high)[out] - z[out]
        free &= ~out
    return np.asarray(np.clip(z + step, low, high))
