"""What many tests do: run the command, and wait until something holds."""

import io
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import chdir, nullcontext, redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from tailbeat.cli.app import main


def command(*words: object) -> list[str]:
    """The command `tailbeat` with these words, for a process of its own."""
    return [sys.executable, "-m", "tailbeat", *map(str, words)]


def importing_as_here() -> dict[str, str]:
    """The environment of a process that imports what this one does, the tests too."""
    paths = [str(Path(__file__).parent), *filter(None, sys.path)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def tailbeat_process(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own to its end; five minutes at most."""
    return subprocess.run(command(*words), capture_output=True, text=True, cwd=cwd, timeout=300)


def tailbeat(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in this process by its entry point: seconds of imports are saved.

    A traceback reaches the test. What a child process prints is not captured.
    """
    out, errors, called = io.StringIO(), io.StringIO(), ["tailbeat", *map(str, words)]
    with (
        pytest.MonkeyPatch.context() as patch,
        chdir(cwd) if cwd else nullcontext(),
        redirect_stdout(out),
        redirect_stderr(errors),
    ):
        patch.setattr(sys, "argv", called)
        code = _exit_code()
    return subprocess.CompletedProcess(called, code, out.getvalue(), errors.getvalue())


def _exit_code() -> int:
    try:
        main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 1
    return 0


def complaint(*words: object, cwd: Path | None = None) -> str:
    """The one line with which the command refuses these words, with exit code 2."""
    done = tailbeat(*words, cwd=cwd)
    assert done.returncode == 2, (words, done.returncode, done.stdout, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def until(
    holds: Callable[[], object],
    what: Callable[[], object] = lambda: "nothing happened",
    seconds: float = 60.0,
) -> None:
    """Wait until something holds; `what` says what held instead. A busy machine gets a minute."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"waited {seconds:g} s in vain: {what()}"
        time.sleep(0.01)
