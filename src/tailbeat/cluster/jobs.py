"""Independent jobs in many processes: of this machine, or as Ray tasks of a cluster."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

from tailbeat.processes import ALONE, cores, end_with, fork_server

Job = TypeVar("Job")
Result = TypeVar("Result")
Report = Callable[[int, int], None]  # jobs done, all jobs


def map_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    report: Report,
    address: str | None = None,
    preload: Sequence[str] = (),
) -> list[Result]:
    """The results of `function` for every job, in their order; the same wherever it runs.

    Without an `address` each core has a process, which imports the modules `preload` once; with it,
    each job is a Ray task of one core. Function, jobs and results must be picklable. The first
    error of a job ends all; Ctrl-C ends all.
    """
    swum: dict[int, Result] = {}
    how = _in_ray(function, jobs, address) if address else _in_pool(function, jobs, preload)
    for number, result in how:
        swum[number] = result
        report(len(swum), len(jobs))
    return [swum[number] for number in range(len(jobs))]


def _in_pool(
    function: Callable[[Job], Result], jobs: Sequence[Job], preload: Sequence[str]
) -> Iterator[tuple[int, Result]]:
    """Number and result of each job, as they end."""
    count = max(min(cores(), len(jobs)), 1)
    with _deafened():
        pool = ProcessPoolExecutor(count, fork_server(preload), _begin, (os.getpid(),))
    try:
        with _deafened():
            numbers: dict[Future[Result], int] = {
                pool.submit(function, job): number for number, job in enumerate(jobs)
            }
        left = set(numbers)
        while left:
            done, left = wait(left, return_when=FIRST_COMPLETED)
            for one in done:
                yield numbers[one], one.result()
    finally:
        with _deafened():  # a second Ctrl-C would leave processes behind
            workers = list((pool._processes or {}).values())  # public from Python 3.14 on
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.terminate()


@contextmanager
def _deafened() -> Iterator[None]:
    """Ignore Ctrl-C while processes start or end: they inherit that, and none is left half
    started."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(driver: int) -> None:
    """Leave Ctrl-C to the process that started this one, which ends it; end when that is killed.
    Its pool would wait for jobs for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(driver)


def _in_ray(
    function: Callable[[Job], Result], jobs: Sequence[Job], address: str
) -> Iterator[tuple[int, Result]]:
    """Number and result of each job, as they end."""
    from tailbeat.cluster import connection

    connection.connect(address)
    import ray

    task: Any = ray.remote(num_cpus=1, runtime_env={"env_vars": ALONE})(_call)
    sent = ray.put(function)  # once, with all that it holds
    numbers = {task.remote(sent, job): number for number, job in enumerate(jobs)}
    left = list(numbers)
    while left:
        done, left = ray.wait(left)
        for one in done:
            yield numbers[one], _result(one)


def _call(function: Callable[[Job], Result], job: Job) -> Result:
    """A Ray task: Ray takes plain functions only, and `function` may be a partial one."""
    return function(job)


def _result(task: Any) -> Any:
    """What a Ray task returned; its error is the job's own, as in a pool."""
    import ray

    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
