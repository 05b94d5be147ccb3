"""Play a test bench's protocol in the virtual pool and write its recordings."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.protocol import present_name
from tailbeat.pool.mess import lab_at
from tailbeat.pool.protocols import record_check, record_fluid, record_servo, record_tail
from tailbeat.recording import Recording, read_recording, write_recording

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
    given = [read_recording(path) for path in commands]
    lab = lab_at(mess, seed)
    for recording in RECORDERS[kind](load_fish(fish), seed, commands=given, lab=lab):
        paths.append(out / f"{recording.name}.csv")
        write_recording(recording, paths[-1])
    return paths
