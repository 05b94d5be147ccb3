"""A twin compared with new recordings of its fish: tail, servo and swims, recorded in the pool.

Nothing is fitted to the recordings of servo and swims: they test the twin on new data. The tail's
response is measured again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.evaluate.speed_map import SpeedMap, speed_map
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.predict import predict, row
from tailbeat.identify.protocol import (
    EVERY,
    HELD_OUT_SERVO,
    fluid_runs,
    limits,
    present_name,
    servo_commands,
)
from tailbeat.identify.runs import as_run
from tailbeat.identify.servo import as_bench, described_servo
from tailbeat.identify.servo_job import Overlay
from tailbeat.identify.shaft import free_run
from tailbeat.identify.tail import identify_tail
from tailbeat.pool.protocols import record_fluid, record_servo, record_tail
from tailbeat.recording import Recording, read_recording, write_recording

SERVOS = ("identified", "idealised")
IDEAL = "idealised"


@dataclass(frozen=True, eq=False)
class Day:
    """One day's recordings."""

    tail: list[Recording]
    servo: list[Recording]
    fluid: list[Recording]


@dataclass(frozen=True)
class TailRow:
    """A `number` of the tail: the twin's, and the newly measured one with its 95 % interval (k_eff
    in N m/rad, friction in N m)."""

    number: str
    twin: float | None
    measured: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class ServoRow:
    """Free-run error [deg rms] of the twin's servo and of the idealised one on a recording."""

    recording: str
    identified_rms_deg: float
    idealised_rms_deg: float


@dataclass(frozen=True)
class SwimRow:
    """A held-out swim and the twin's: beat [Hz], speeds [m/s], rms position error as a fraction of
    the path length, heading error [deg]; None where a run does not have the number."""

    recording: str
    beat_frequency: float | None
    measured_speed: float | None
    predicted_speed: float | None
    position_error_share: float | None
    heading_error_deg: float | None


@dataclass(frozen=True)
class FreshResult:
    """Results of a twin on new recordings; `speeds` is None in older folders."""

    tail: tuple[TailRow, ...]
    servo: tuple[ServoRow, ...]
    swims: tuple[SwimRow, ...]
    speeds: SpeedMap | None = None


def record(fish: Fish, out: Path, seed: int) -> None:
    """Record what is missing, with a seed that no identification used."""
    servo = [
        one for name, one in servo_commands(fish, limits(fish)).items() if name in HELD_OUT_SERVO
    ]
    swims = list(fluid_runs(fish, limits(fish)).values())[EVERY - 1 :: EVERY]
    other = 1_000 + seed
    there = {present_name(path.stem) for path in out.glob("*.csv")}
    for made in (
        record_tail(fish, other),
        record_servo(fish, other, commands=servo),
        record_fluid(fish, other, commands=swims),
    ):
        for recording in made:
            if recording.name not in there:
                write_recording(recording, out / f"{recording.name}.csv")


def read(out: Path) -> Day:
    """Read the day's recordings. Raises BadInput if one kind is missing."""
    names = sorted(out.glob("*.csv"))
    found = {
        kind: [path for path in names if present_name(path.stem).startswith(f"{kind}-")]
        for kind in ("tail", "servo", "fluid")
    }
    for kind, paths in found.items():
        if not paths:
            raise BadInput(
                f"{out}: no {kind} recordings; run `tailbeat evaluate --tasks twin` again."
            )
    return Day(*([read_recording(path) for path in paths] for paths in found.values()))


def numbers(out: Path, pool_fish: Fish, twin: Fish) -> FreshResult:
    """Measure the fish from the new recordings, and compute its twin's numbers."""
    day = read(out)
    tail = identify_tail([one for one in day.tail if "sweep" in one.name])
    return FreshResult(
        tail=(
            TailRow("k_eff", twin.tail.k_eff, tail.k_eff.value, tail.k_eff.interval),
            TailRow("friction", twin.tail.friction, tail.coulomb.value, tail.coulomb.interval),
        ),
        servo=tuple(
            ServoRow(one.bench.name, *(_rms(one.error_deg(which)) for which in SERVOS))
            for one in overlays(day, twin)
        ),
        swims=tuple(
            _swim_row(row(one)) for one in predict(twin, [as_run(run, twin) for run in day.fluid])
        ),
        speeds=speed_map(pool_fish, [twin.servo], twin),
    )


def _swim_row(found: Mapping[str, Any]) -> SwimRow:
    names = (field.name for field in fields(SwimRow))
    return SwimRow(*(found.get(name) for name in names))  # type: ignore[arg-type]


def overlays(day: Day, twin: Fish) -> list[Overlay]:
    """Free runs of the twin's servo and the idealised one on the day's commands."""
    benches = [as_bench(one, twin) for one in day.servo]
    ideal = twin.servos.get(IDEAL, twin.servos[twin.servo])
    own, other = (
        free_run(described_servo(servo), benches) for servo in (twin.servos[twin.servo], ideal)
    )
    return [
        Overlay(bench, "held out", a[0], b[0])
        for bench, a, b in zip(benches, own, other, strict=True)
    ]


def _rms(values: Any) -> float:
    return float(np.sqrt(np.square(values).mean()))
