"""The margins of a policy, their cells in many processes of a Ray cluster."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.cluster.jobs import map_jobs
from tailbeat.cluster.same import absolute, load_same, with_absolute
from tailbeat.control.policy import contract_digest, load_policy
from tailbeat.evaluate.margin_cells import Cell, Hits, Table, swum
from tailbeat.evaluate.margins import Margins, MarginsConfig, Report, margins, pool_for

EACH = 5  # cells of a job: a minute or so
ALL = 1_000_000  # cells of a batch


@dataclass(frozen=True)
class CellsJob:
    """Some cells to swim on by a policy of that name and digest, and the hits that they have."""

    policy: str
    digest: str
    config: MarginsConfig
    cells: tuple[Cell, ...]
    held: tuple[Hits, ...]


def margins_on(
    address: str, policy: str, config: MarginsConfig, out: Path, report: Report
) -> Margins:
    """As `evaluate.margins.margins`, to the bit, on a Ray cluster, whose nodes must see the file
    `policy` under the same path, or have the shipped policy of that name. Raises BadInput."""
    from tailbeat.cluster import connection

    connection.connect(address)  # before anything is written
    path, loaded, config = absolute(policy), load_policy(policy), with_absolute(config)
    digest = contract_digest(loaded.contract)

    def swim(cells: Sequence[Cell], table: Table) -> dict[Cell, Hits]:
        jobs = []
        for first in range(0, len(cells), EACH):
            own = tuple(cells[first : first + EACH])
            held = tuple(table.get(cell, Hits()) for cell in own)
            jobs.append(CellsJob(path, digest, config, own, held))
        found = map_jobs(swim_cells, jobs, lambda *_: None, address)
        return {cell: hits for one in found for cell, hits in one.items()}

    return margins(loaded, config, out, report, swim, ALL)


def swim_cells(job: CellsJob) -> dict[Cell, Hits]:
    """Swim a job's cells on. Raises BadInput if the policy is another one here."""
    policy = load_same(job.policy, job.digest)
    table = dict(zip(job.cells, job.held, strict=True))
    return swum(policy, pool_for(policy, job.config), job.cells, table)
