"""Write the command recordings of a protocol into a folder."""

from pathlib import Path

from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.store import load_fish
from tailbeat.identify import protocol
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.recording import write_recording

PROTOCOLS = ("tail", "servo", "fluid", "check")


def write_protocol(kind: str, fish: str, out: Path, speed: float | None = None) -> list[Path]:
    """Write the command recordings of one test bench, one of `PROTOCOLS`, into a folder.

    `speed` is the largest shaft speed [rad/s] (None: the described servo's). Returns the paths,
    .csv. Raises BadInput for another kind, a crank, a speed that is not above 0, or a file that
    exists.
    """
    if kind not in PROTOCOLS:
        raise BadInput(f"protocol {kind!r}: allowed are {', '.join(PROTOCOLS)}.")
    described = load_fish(fish)
    limit = protocol.limits(described, speed)
    if kind == "tail":
        made = {
            "tail-sweep": protocol.tail_sweep(described, limit),
            "tail-static": protocol.tail_static(limit),
        }
    elif kind == "servo":
        made = protocol.servo_commands(described, limit)
    elif kind == "check":
        made = check_swims(described, limit)
    else:
        made = {**protocol.fluid_runs(described, limit), **manoeuvres(described, limit)}
    paths = [out / f"{name}.csv" for name in made]
    for path in paths:
        refuse_existing(path)
    for path, recording in zip(paths, made.values(), strict=True):
        write_recording(recording, path)
    return paths
