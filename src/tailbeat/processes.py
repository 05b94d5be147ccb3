"""Start and end Python processes, and catch the signals that ask this process to end."""

import contextlib
import ctypes
import fcntl
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.files import BadInput

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.context import ForkServerContext
    from multiprocessing.process import BaseProcess

LINGER = 10.0  # s that a process may take to end
GIT = 0.5  # s that git may take to answer
OWNER, NEW = ".owner", 60.0  # lock in a temporary folder, and the age [s] from which it is tried
# One fish needs one thread.
ALONE = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TAILBEAT_THREADS": "1"}


def threads() -> int:
    """How many threads step a batch of fish: TAILBEAT_THREADS, else 0, every core.

    Threads of one batch wait for each other at every step. Where several processes share the cores
    one thread each is fastest. Raises BadInput for a value that is no whole number from 0 on.
    """
    told = os.environ.get("TAILBEAT_THREADS", "0")
    if not told.isdecimal():
        raise BadInput(f"TAILBEAT_THREADS={told}: give a whole number of threads; 0: every core.")
    return int(told)


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def start(words: Sequence[str], **more: Any) -> "subprocess.Popen[Any]":
    """Start `python words` in its own session, so that Ctrl-C reaches only this process.
    `more` goes to `subprocess.Popen`."""
    return subprocess.Popen([sys.executable, *words], start_new_session=True, **more)


def start_verb(
    words: Sequence[str], every_core: bool = False, **more: Any
) -> "subprocess.Popen[str]":
    """Start a verb of tailbeat, `words`. It has one thread, as other verbs share the cores, or
    with `every_core` as many as it likes. It gets SIGTERM when this process dies.
    `more` goes to `subprocess.Popen`; its `env` is added to this process's environment."""
    threads = {} if every_core else ALONE
    more["env"] = {**os.environ, **threads, **more.get("env", {})}
    words = ["-m", "tailbeat", *words]
    return start(words, text=True, preexec_fn=end_with_parent, **more)


def git_describe() -> str:
    """What `git describe` says of this package's checkout, with -dirty where files were changed."""
    package = Path(__file__).parent
    if not (package.parents[1] / ".git").exists():
        return "not a checkout"
    asked = ["git", "-C", str(package), "describe", "--tags", "--always", "--dirty"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=GIT)
    except (OSError, subprocess.SubprocessError):
        return "unknown: git did not answer"
    return done.stdout.strip()


def fork_server(preload: Sequence[str]) -> "ForkServerContext":
    """A context of multiprocessing whose processes are forked from one that has imported `preload`
    and has few threads: many like processes start at once."""
    import multiprocessing  # takes 0.1 s, and the robot's loop does without
    from multiprocessing import forkserver

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    before = os.environ.copy()
    os.environ.update(ALONE)
    try:
        forkserver.ensure_running()
    finally:
        for name in ALONE:
            os.environ.pop(name)
        os.environ.update(before)
    return context


def spawn(target: Callable[..., None], *words: Any) -> "tuple[BaseProcess, Connection]":
    """Start `target(*words, pipe)` in a fresh process that ends with this one. Returns the process
    and this end of the pipe, from which its messages are read."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=target, args=(*words, theirs), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def end_with_parent() -> None:
    """Send this process SIGTERM when its parent dies (Linux: prctl(2), PR_SET_PDEATHSIG)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)


def end_with(pid: int) -> None:
    """End this process at once when process `pid`, which need not be its parent, ends (Linux:
    pidfd_open(2)). What it is writing stays unfinished, as if it were killed."""
    with contextlib.suppress(OSError, AttributeError):
        ended = os.pidfd_open(pid)
        watch = threading.Thread(target=lambda: select.select([ended], [], []) and os._exit(1))
        watch.daemon = True
        watch.start()


def end(
    process: "subprocess.Popen[Any]",
    number: signal.Signals = signal.SIGINT,
    patience: float = LINGER,
) -> None:
    """End a process by a signal, as Ctrl-C would; kill it after `patience` [s]."""
    if process.poll() is None:
        process.send_signal(number)
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def told_to_end(*numbers: signal.Signals) -> list[int]:
    """Catch the signals `numbers`, by default SIGINT (Ctrl-C) and SIGTERM. Returns a list; each
    caught signal's number is appended to it."""
    ended: list[int] = []
    for number in numbers or (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _: ended.append(n))
    return ended


@contextmanager
def temporary() -> Iterator[str]:
    """A temporary folder that only its owner may read, removed at the end. First removes those
    that were left by processes that were killed: keys of emulated devices are in them."""
    _sweep()
    with (
        tempfile.TemporaryDirectory(prefix="tailbeat-") as name,
        open(Path(name) / OWNER, "wb") as owner,
    ):
        fcntl.flock(owner, fcntl.LOCK_EX)  # the kernel gives it back when this process dies
        yield name


def _sweep() -> None:
    """Remove our temporary folders whose lock nobody holds; one that is new may not have it yet."""
    for folder in Path(tempfile.gettempdir()).glob("tailbeat-*"):
        with contextlib.suppress(OSError), open(folder / OWNER, "rb") as owner:
            seen = os.fstat(owner.fileno())
            if seen.st_uid == os.getuid() and time.time() - seen.st_mtime > NEW:
                fcntl.flock(owner, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
