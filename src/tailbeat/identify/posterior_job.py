"""`tailbeat identify posterior`: the posterior of a fish that was identified before."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.description import Fish
from tailbeat.fish.store import fish_path, load_fish, value_at
from tailbeat.identify import posterior
from tailbeat.identify.bands import swim_all
from tailbeat.identify.doubt import by_swims, draw
from tailbeat.identify.fluid import fluid_space, owners, residual_function, with_row
from tailbeat.identify.job import BANDED, FluidConfig, check, parts_of
from tailbeat.identify.posterior import Posterior
from tailbeat.identify.runs import Run, as_runs
from tailbeat.identify.search import Fit
from tailbeat.identify.space import WIDE_STEP, Parameter, bounds, cost, covariance, sensitivity
from tailbeat.identify.space import values as values_at
from tailbeat.recording import read_recordings, refuse_shared


def write_posterior(
    fish: str,
    fit: Sequence[Path],
    check_swims: Sequence[Path],
    out: Path | None,
    config: FluidConfig,
) -> Path:
    """Write the posterior of an identified fish, from the recordings that it was fitted to and
    swims that it was not; `out` None: beside the fish. Of the `config` its zones, draws and first
    seed count. Returns its path. Raises BadInput."""
    described, path = load_fish(fish), out or posterior.beside(fish_path(fish))
    if path.suffix != ".parquet":
        raise BadInput(f"--out {path}: a posterior is a Parquet file; give a name in .parquet.")
    refuse_existing(path)
    check(config)
    refuse_shared({"--fit": fit, "--check": check_swims})
    runs, judged = (
        [run for one in read_recordings(group) for run in as_runs(one, described)]
        for group in (fit, check_swims)
    )
    if not runs:
        raise BadInput("--fit is empty; give the recordings that the fish was fitted to.")
    posterior.write(path, posterior_of(described, runs, judged, config))
    return path


def posterior_of(
    fish: Fish, fit: Sequence[Run], judged: Sequence[Run], config: FluidConfig
) -> Posterior:
    """The posterior about the fish's own numbers; nothing is fitted. `judged` are swims that were
    not fitted, for the discrepancy."""
    check(config)
    space = fluid_space(fish, config.zones)
    residuals = residual_function(fish, fit, space, config.start_weight)
    z = np.array([p.to_z(value_at(fish, _one(fish, p))) for p in space])
    found, slope = sensitivity(residuals, z, step=WIDE_STEP, edges=bounds(space))
    own = Fit(0, z, float(cost(found, z)), found, slope, covariance(slope))
    parts = parts_of(fish, fit, space, config.start_weight)
    doubts = [by_swims(own, owners(fish, fit))]
    drawn = draw(space, doubts, parts, config.draws, config.first_seed)
    rows = np.array([list(values_at(space, one).values()) for one in drawn])
    paths = [p.path for p in space]
    swims = swim_all([with_row(fish, paths, row) for row in rows[:BANDED]], judged)
    return posterior.drawn_for(fish, space, rows, fit, swims)


def _one(fish: Fish, parameter: Parameter) -> str:
    """The field of a parameter, of any one zone if it is all zones'."""
    return parameter.path.replace("*", next(iter(fish.zones)))
