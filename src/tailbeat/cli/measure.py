"""Write protocols, record them, import recordings."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.options import FishOption, JsonOption, MessOption, SeedOption
from tailbeat.files import check_json, put_json, write_json

SourceOption = Annotated[
    str, typer.Option(help="Who recorded it, and where; written to the metadata.")
]


def protocol(
    kind: Annotated[str, typer.Argument(help="tail, servo, fluid or check.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder of the command recordings.")],
    speed: Annotated[
        float | None,
        typer.Option(help="Largest shaft speed in the commands [rad/s]; default: the servo's."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Write the commands that the test bench plays. docs/how-to/record.md has the steps."""
    check_json(json)
    from tailbeat.identify.commands import write_protocol

    paths = write_protocol(kind, fish, out, speed)
    put_json(json, {"recordings": [str(path) for path in paths]})
    for path in paths:
        output.say(f"wrote {path}")


def record(
    kind: Annotated[str, typer.Argument(help="tail, servo, fluid or check.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder of the recordings.")],
    commands: Annotated[
        list[Path] | None,
        typer.Option("--commands", help="Commands to play; default: the protocol's."),
    ] = None,
    mess: MessOption = "clean",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Play a protocol in the virtual pool and record it as a lab would."""
    check_json(json)
    from tailbeat.pool import record as recorder

    paths = recorder.record(kind, fish, out, seed, commands or (), mess)
    put_json(json, {"recordings": [str(path) for path in paths]})
    for path in paths:
        output.say(f"wrote {path}")


def import_fishsim(
    csv: Annotated[Path, typer.Argument(help="A marker file of srl-ethz/fishsim.")],
    out: Annotated[Path, typer.Option("--out", help="Recording to write, .csv or .parquet.")],
    frame_rate: Annotated[float, typer.Option(help="Frames per second of the video [Hz].")] = 60.0,
    json: JsonOption = None,
) -> None:
    """Convert marker tracks in pixels to a recording in metres."""
    from tailbeat.importers.fishsim import convert

    check_json(json)
    recording = convert(csv, out, frame_rate)
    put_json(json, {"recording": str(out), "frames": recording.time.size, **recording.meta})
    dropped = recording.meta["frames_dropped_per_marker"]
    output.say(f"wrote {out}: {recording.time.size} frames, dropped per marker {dropped}")


def import_xl330(
    log: Annotated[Path, typer.Argument(help="A pendulum log of Rhoban/bam, .json.")],
    out: Annotated[Path, typer.Option("--out", help="Recording to write, .csv or .parquet.")],
    source: SourceOption = "",
    json: JsonOption = None,
) -> None:
    """Convert a servo's pendulum log to a recording. Gain and load go into its metadata."""
    from tailbeat.importers.xl330 import convert

    check_json(json)
    recording = convert(log, out, source)
    put_json(json, {"recording": str(out), "rows": recording.time.size, **recording.meta})
    gain = recording.meta["gain"]
    output.say(f"wrote {out}: {recording.time.size} samples at gain {gain}")


def import_table(
    table: Annotated[Path, typer.Argument(help="A table: .csv, .json or .parquet.")],
    out: Annotated[Path, typer.Option("--out", help="Recording to write, .csv or .parquet.")],
    columns: Annotated[
        str,
        typer.Option(
            "--map",
            help="Columns of the table: time=NAME,angle=NAME; also command, motor_angle, torque, x,"
            " y, yaw, enabled, condition, gain, load, load_mass, load_arm, marker0_x.",
        ),
    ],
    unit: Annotated[
        str,
        typer.Option(
            help="Units of the mapped columns: rad, deg, turns, counts; s, ms, us; m, cm, mm; Nm,"
            " mNm; kg, g; default: SI."
        ),
    ] = "",
    meta: Annotated[
        str,
        typer.Option(
            help="Metadata: gain=400,load_mass_kg=mass; a number in SI, or the name of a JSON"
            " header field."
        ),
    ] = "",
    rows: Annotated[
        str | None,
        typer.Option(help="JSON field with the entries or their lists; default: the only list."),
    ] = None,
    source: SourceOption = "",
    counts_per_turn: Annotated[
        float | None, typer.Option(help="Encoder counts of one turn, for --unit counts.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Convert any table to a recording in SI units. Name its columns and state its units."""
    from tailbeat.importers.table import TableConfig, convert, parse_pairs

    check_json(json)
    pairs, known = parse_pairs("--map", columns), parse_pairs("--meta", meta)
    units = [word.strip() for word in unit.split(",") if word.strip()]
    config = TableConfig(pairs, units, known, rows, source, counts_per_turn)
    recording = convert(table, out, config)
    names = [*recording.columns, *recording.labels]
    if json is not None:
        told = {"recording": str(out), "rows": recording.time.size, "columns": names}
        write_json(json, {**recording.meta, **told, "meta": recording.meta})
    output.say(f"wrote {out}: {recording.time.size} samples of {', '.join(names)}")
