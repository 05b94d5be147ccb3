"""The controlled comparison, its cells in many processes."""

from dataclasses import dataclass, replace
from pathlib import Path

from tailbeat.cluster.jobs import map_jobs
from tailbeat.cluster.same import absolute, check_same, with_absolute
from tailbeat.evaluate.compare import (
    ComparisonConfig,
    cells_left,
    conclude,
    digests_of,
    swim_cell,
)
from tailbeat.evaluate.comparison import Comparison, cell_path
from tailbeat.evaluate.trial import Progress
from tailbeat.files import write_json


@dataclass(frozen=True)
class CellJob:
    """A cell to swim: a policy's name, a condition, the policy's digest, and the file to write."""

    config: ComparisonConfig
    policy: str
    condition: str
    digest: str
    path: Path


def compare(
    config: ComparisonConfig, out: Path, progress: Progress, address: str | None = None
) -> Comparison:
    """Swim every policy under every condition of the pool, each cell into a file, and read the
    numbers of all cells in the folder `out`; those on disk are not swum again. With an `address`
    the cells are swum on a Ray cluster, whose nodes must see `out` under the same path. Raises
    BadInput if a policy does not fit, or if a cell on disk is another policy's."""
    paths = tuple(map(absolute, config.policies))
    config, out = with_absolute(replace(config, policies=paths)), out.absolute()
    digests = digests_of(config)
    jobs = [
        CellJob(config, *one, digests[one[0]], cell_path(out, *one))
        for one in cells_left(config, out)
    ]

    def report(done: int, total: int) -> None:
        progress("cells", done, total)

    map_jobs(swim, jobs, report, address, preload=(__name__,))
    return conclude(out)


def swim(job: CellJob) -> None:
    """Swim a cell, and write its file. Raises BadInput if the policy is another one here."""
    cell = swim_cell(job.config, job.policy, job.condition)
    check_same(job.policy, str(cell.digest), job.digest)
    write_json(job.path, cell)
