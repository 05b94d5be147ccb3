"""An evaluation of a policy, its swims in many processes of a Ray cluster."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tailbeat.cluster.jobs import map_jobs
from tailbeat.cluster.same import absolute, load_same, with_absolute
from tailbeat.control.policy import contract_digest, decide, load_policy
from tailbeat.evaluate.evaluation import Evaluation, EvaluationConfig, evaluate
from tailbeat.evaluate.trial import Chunk, Progress, swim_chunk


@dataclass(frozen=True)
class ChunkJob:
    """A chunk to swim by a policy of that name and digest."""

    policy: str
    digest: str
    chunk: Chunk


def evaluate_on(
    address: str, policy: str, config: EvaluationConfig, out: Path, progress: Progress
) -> Evaluation:
    """As `evaluate.evaluation.evaluate`, to the bit, on a Ray cluster, whose nodes must see the
    folder `out` and the file `policy` under the same paths, or have the shipped policy of that
    name. Chunks on disk are not swum again. Raises BadInput."""
    from tailbeat.cluster import connection

    connection.connect(address)  # before anything is written
    path, loaded = absolute(policy), load_policy(policy)
    digest = contract_digest(loaded.contract)

    def swim_all(chunks: Sequence[Chunk], progress: Progress) -> None:
        left = [ChunkJob(path, digest, one) for one in chunks if not one.path.is_file()]
        map_jobs(swim, left, partial(progress, "chunks"), address)

    return evaluate(loaded, with_absolute(config), out.resolve(), progress, swim_all)


def swim(job: ChunkJob) -> None:
    """Swim a chunk, and write its file. Raises BadInput if the policy is another one here."""
    swim_chunk(partial(decide, load_same(job.policy, job.digest)), job.chunk)
