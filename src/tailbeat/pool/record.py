"""Play a test bench's protocol in the virtual pool and write its recordings."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.store import load_fish
from tailbeat.identify.protocol import present_name
from tailbeat.pool.mess import lab_at
from tailbeat.pool.protocols import record_check, record_fluid, record_servo, record_tail
from tailbeat.recording import Recording, read_recordings, write_recording

RECORDERS: dict[str, Callable[..., Iterator[Recording]]] = {
    "tail": record_tail,
    "servo": record_servo,
    "fluid": record_fluid,
    "check": record_check,
}


def record(
    kind: str,
    fish: str,
    out: Path,
    seed: int,
    commands: Sequence[Path] = (),
    mess: str = "clean",
) -> list[Path]:
    """Play a protocol, or given commands, in the virtual pool. Writes its recordings and returns
    their paths. With `mess` a level of `pool.mess`, all are of one lab, drawn from the seed: that
    of the first swim of `evaluate --tasks messy`. Raises BadInput."""
    if kind not in RECORDERS:
        raise BadInput(f"record {kind!r}: allowed are {', '.join(RECORDERS)}.")
    if any(present_name(path.stem).startswith(f"{kind}-") for path in out.glob("*.csv")):
        raise BadInput(f"{out}: {kind} recordings exist already; give an empty folder.")
    paths = []
    given = [_from_zero(one) for one in read_recordings(commands)]
    for one in given:
        refuse_existing(_path(out, one))
    lab = lab_at(mess, seed)
    for recording in RECORDERS[kind](load_fish(fish), seed, commands=given, lab=lab):
        paths.append(_path(out, recording))
        write_recording(recording, paths[-1])
    return paths


def _from_zero(commands: Recording) -> Recording:
    """Commands whose time begins at 0: a log's may begin at any time of day."""
    return replace(commands, time=commands.time - commands.time[0])


def _path(out: Path, recording: Recording) -> Path:
    return out / f"{recording.name.replace('/', '-')}.csv"
