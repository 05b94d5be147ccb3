"""What the fuzz tests share: every verb with its parameters, odd values, and what must hold after.

The verbs come from the command line's own tree, so a new one is covered at once.
"""

import contextlib
import hashlib
import os
import shutil
import signal
import stat
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support import tailbeat
from tailbeat.cli.group import Listed, load, tree

WORK = 20.0  # s of processor time that bad input may take
PATIENCE = 120.0  # s that it may take beside other programs: it waits for nothing
LONGEST = 1500  # characters of a complaint: names of 300 letters may be in it twice
LONG = "n" * 300
EARLIER = "left by an earlier run"


# ---- verbs --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parameter:
    """An argument (`option` is "") or an option of a verb. `kind` is its type's name."""

    name: str
    option: str
    kind: str
    required: bool
    several: bool

    @property
    def of_path(self) -> bool:
        """Whether something on the disk is named, or may be."""
        return self.kind == "Path" or self.name in NAMES

    def words(self, value: str) -> list[str]:
        """As typed. With `=`, so that a value may begin with a dash."""
        return [f"{self.option}={value}"] if self.option else [value]


NAMES = {
    "fish", "policy", "policies", "twin", "pool_fish", "file", "first", "second", "views",
    "picture", "camera", "servo", "imu", "key",
}  # fmt: skip
# Bad wherever a path is given: to be read it is missing or no such file, to be written it is taken.
BAD_PATHS = (
    "plain.txt/inside", LONG, f"{LONG}/inside", "plain.txt", "empty", "pipe", "loop", "hole",
    "/dev/null/inside", "/dev/null", "/dev/zero", "/dev/full", "a folder",
    "plain.txt/", "plain.txt/\udcff\udc80", "plain.txt/mit Leerzeichen/鱼", "plain.txt/two\nlines",
)  # fmt: skip
ODD_NUMBERS = (
    "-1", "0", "1", "nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "9" * 30, "", " ", "٣",
    "0x10", "1_0", "-0.0", "2147483648", "1e9", "-9223372036854775809",
)  # fmt: skip
ODD_TEXTS = (
    "", " ", "-", "--", ".", "..", "/", "~", LONG, "\udcff", "鱼 ü", "a,b", "nan,nan",
    "1e300,1e300", "inf,0", "1,1,1", "1e9x1e9", "nanxnan", "-1x-1", "0x0", "host:99999",
    ":1", "h:99999", "127.0.0.1:-1", "[::1]:1", "256.0.0.1:1", f"{'h' * 300}:1", "0/0", "2/1",
    "1/99999999999", "[red]", "%s", "{}", "\x1b[31m", "a=b=c", "=", "time=", "=t", "two\nlines",
    "-1g", "1e300mm", "nankg", "0x0mm", "generator", "pulley-fish", "9" * 30, "unix:",
    "unix:/dev/null", "/dev/null",
)  # fmt: skip


def verbs() -> dict[str, tuple[Parameter, ...]]:
    """Every verb of the command line, by its words, with its parameters."""
    return dict(_below(tree(), ""))


def _below(group: Any, before: str) -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    for name, command in group.commands.items():
        words = f"{before} {name}".strip()
        if isinstance(command, Listed):
            yield words, tuple(map(_parameter, load(command.verb).params))
        else:
            yield from _below(command, words)


def _parameter(given: Any) -> Parameter:
    kind = given.type_descriptor.annotation
    option = next((word for word in given.opts if word.startswith("--")), "")
    several = given.nargs != 1 or given.multiple
    return Parameter(
        given.name, option, getattr(kind, "__name__", str(kind)), given.required, several
    )


# ---- a folder in which everything goes wrong ----------------------------------------------------


def furnish(folder: Path) -> None:
    """Put there what `BAD_PATHS` names."""
    (folder / "plain.txt").write_text(EARLIER)
    (folder / "empty").touch()
    (folder / "a folder").mkdir()
    (folder / "a folder" / "inside.txt").write_text(EARLIER)
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to("loop")
    (folder / "hole").symlink_to("nothing")


def contents(folder: Path) -> dict[str, str]:
    """Every file below a folder by its path, with a digest of its bytes; folders too."""
    return {
        os.fsencode(path.relative_to(folder)).hex(" "): _digest(path) for path in folder.rglob("*")
    }


def _digest(path: Path) -> str:
    kind = path.lstat().st_mode
    if not stat.S_ISREG(kind):
        return "folder" if stat.S_ISDIR(kind) else "special"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def cleared(folder: Path) -> Path:
    """The folder, empty."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


# ---- a run, and what must hold after it ---------------------------------------------------------


class TookTooLong(BaseException):
    """A verb worked longer than `PATIENCE`. No `except Exception` catches it."""


@contextlib.contextmanager
def patience(seconds: float) -> Iterator[None]:
    """Raise TookTooLong inside after this time."""

    def over(number: int, frame: Any) -> None:
        raise TookTooLong

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def survives(words: list[str], folder: Path) -> int:
    """Run a verb in `folder` and check all that must hold whatever it is given; returns its exit
    code. An exception of the verb reaches the test."""
    before = contents(folder)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    began = time.process_time()
    try:
        with patience(PATIENCE):
            done = tailbeat(*words, cwd=folder)
    except TookTooLong:
        raise AssertionError(f"{words}: longer than {PATIENCE:g} s") from None
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # a drive asks for more
    assert time.process_time() - began < WORK, words
    check(done, before, contents(folder))
    return done.returncode


def check(
    done: subprocess.CompletedProcess[str], before: dict[str, str], after: dict[str, str]
) -> None:
    """One sentence and nothing written if the input was refused; inputs as they were; no
    traceback."""
    said = done.stdout + done.stderr
    assert done.returncode in (0, 1, 2), (done.returncode, said)
    assert "Traceback" not in said, said
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    assert not changed, [bytes.fromhex(name) for name in changed]
    new = [bytes.fromhex(name) for name in after if name not in before]
    assert not [name for name in new if os.path.basename(name).startswith(b".")], new
    if done.returncode == 2:
        lines = done.stderr.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("tailbeat: "), lines
        assert len(lines[0]) < LONGEST and lines[0].endswith((".", "?")), lines
        assert not new, (new, lines)
