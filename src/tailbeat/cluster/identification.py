"""The searches of an identification, in many processes of a Ray cluster."""

from dataclasses import dataclass
from pathlib import Path

from tailbeat.cluster.jobs import Report, map_jobs
from tailbeat.fish.description import Fish
from tailbeat.identify import job, stages
from tailbeat.identify.runs import Run


@dataclass(frozen=True, eq=False)
class SeedJob:
    """What one search fits, from which seed, and the folder in which it leaves its result."""

    fish: Fish
    fit: tuple[Run, ...]
    config: job.FluidConfig
    scratch: Path
    seed: int


def search_ahead(
    address: str, paths: stages.Paths, config: job.FluidConfig, report: Report
) -> None:
    """Search from every seed on a Ray cluster, whose nodes must see the folder of `paths.scratch`
    under the same path; `stages.fluid` then finds the results there, to the bit those of this
    machine. A search that was interrupted goes on. Raises BadInput."""
    from tailbeat.cluster import connection

    fish, (fit, *_) = stages.swims_of(paths, config)
    connection.connect(address)
    scratch = paths.scratch.resolve()
    jobs = [SeedJob(fish, tuple(fit), config, scratch, seed) for seed in job.seeds_of(config)]
    map_jobs(search, jobs, report, address)


def search(one: SeedJob) -> None:
    """Search from a seed."""
    job.search_ahead(one.fish, one.fit, one.config, one.scratch, one.seed)
