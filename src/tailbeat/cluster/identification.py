"""The searches of an identification, in many processes of a Ray cluster.

Its nodes must see the folder of `paths.scratch` under the same path. The stage then finds the
results there, to the bit those of this machine. A search that was interrupted goes on.
"""

from functools import partial

from tailbeat.cluster.jobs import Report, map_jobs
from tailbeat.identify import job, servo_search, stages


def servo_ahead(
    address: str, paths: stages.Paths, config: servo_search.ServoConfig, report: Report
) -> None:
    """Search from every seed ahead of `stages.servo`, and once more where the gears turn out to
    have no friction; those with a datasheet follow in the stage. Raises BadInput."""
    _, (fit, _) = stages.benches_of(paths, config)
    seeds, scratch = servo_search.seeds_of(config), paths.scratch.resolve()
    search = partial(servo_search.search_ahead, fit, config, scratch)
    map_jobs(partial(search, config.gears), seeds, report, address)
    if servo_search.without_gears(fit, config, scratch):
        map_jobs(partial(search, False), seeds, report, address)


def fluid_ahead(address: str, paths: stages.Paths, config: job.FluidConfig, report: Report) -> None:
    """Search from every seed ahead of `stages.fluid`. Raises BadInput."""
    fish, (fit, *_) = stages.swims_of(paths, config)
    search = partial(job.search_ahead, fish, fit, config, paths.scratch.resolve())
    map_jobs(search, job.seeds_of(config), report, address)
