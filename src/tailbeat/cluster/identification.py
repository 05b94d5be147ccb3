"""The searches of an identification, in many processes of a Ray cluster.

Its nodes must see the folder of `paths.scratch` under the same path. The stage then finds the
results there, to the bit those of this machine. A search that was interrupted goes on.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from tailbeat.cluster.jobs import Report, map_jobs
from tailbeat.identify import job, servo_search, stages


@dataclass(frozen=True, eq=False)
class SeedJob:
    """A seed, and the `search` that leaves what it finds from it in a folder."""

    search: Callable[[int], None]
    seed: int


def servo_ahead(
    address: str, paths: stages.Paths, config: servo_search.ServoConfig, report: Report
) -> None:
    """Search from every seed ahead of `stages.servo`, and once more where the gears turn out to
    have no friction. Raises BadInput."""
    _, (fit, _) = stages.benches_of(paths, config)
    seeds, scratch = servo_search.seeds_of(config), paths.scratch.resolve()
    search = partial(servo_search.search_ahead, fit, config, scratch)
    _search_all(address, partial(search, config.gears), seeds, report)
    if servo_search.without_gears(fit, config, scratch):
        _search_all(address, partial(search, False), seeds, report)


def fluid_ahead(address: str, paths: stages.Paths, config: job.FluidConfig, report: Report) -> None:
    """Search from every seed ahead of `stages.fluid`. Raises BadInput."""
    fish, (fit, *_) = stages.swims_of(paths, config)
    search = partial(job.search_ahead, fish, fit, config, paths.scratch.resolve())
    _search_all(address, search, job.seeds_of(config), report)


def _search_all(
    address: str, search: Callable[[int], None], seeds: Iterable[int], report: Report
) -> None:
    map_jobs(_run, [SeedJob(search, seed) for seed in seeds], report, address)


def _run(one: SeedJob) -> None:
    one.search(one.seed)
