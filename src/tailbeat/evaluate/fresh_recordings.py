"""A twin beside fresh recordings of its fish: tail, servo and swims, recorded anew in the pool.

Nothing is fitted to the servo's and the swims' recordings: the twin is asked for what it was not
shown. The tail's response is measured again.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.motor import as_bench, described_servo
from tailbeat.identify.motor_job import Overlay
from tailbeat.identify.predict import as_json, predict
from tailbeat.identify.protocol import (
    EVERY,
    HELD_OUT_MOTOR,
    fluid_runs,
    limits,
    motor_commands,
)
from tailbeat.identify.runs import as_run
from tailbeat.identify.shaft import free_run
from tailbeat.identify.tail import identify_tail
from tailbeat.pool.protocols import record_fluid, record_motor, record_tail
from tailbeat.recording import Recording, read_recording, write_recording

IDEAL = "idealised"


@dataclass(frozen=True, eq=False)
class Day:
    """One day's recordings."""

    tail: list[Recording]
    motor: list[Recording]
    fluid: list[Recording]


def record(fish: Fish, out: Path, seed: int) -> None:
    """Record what is not there yet, under a seed that no identification used."""
    motor = [
        one for name, one in motor_commands(fish, limits(fish)).items() if name in HELD_OUT_MOTOR
    ]
    swims = list(fluid_runs(fish, limits(fish)).values())[EVERY - 1 :: EVERY]
    other = 1_000 + seed
    for made in (
        record_tail(fish, other),
        record_motor(fish, other, commands=motor),
        record_fluid(fish, other, commands=swims),
    ):
        for recording in made:
            path = out / f"{recording.name}.csv"
            if not path.is_file():
                write_recording(recording, path)


def read(out: Path) -> Day:
    """The day's recordings; raises BadInput where a bench is missing."""
    found = {k: sorted(out.glob(f"{k}-*.csv")) for k in ("tail", "motor", "fluid")}
    for kind, paths in found.items():
        if not paths:
            raise BadInput(f"{out}: no {kind} recordings; evaluate with --tasks twin again.")
    return Day(*([read_recording(path) for path in paths] for paths in found.values()))


def numbers(out: Path, twin: Fish) -> dict[str, Any]:
    """Stiffness and damping measured anew beside the twin's, free-run error of its servo [deg], its
    error along held-out swims."""
    day = read(out)
    tail = identify_tail([one for one in day.tail if "sweep" in one.name])
    return {
        "tail": [
            {"number": name, "twin": value, "measured": one.value, "interval": list(one.interval)}
            for name, value, one in (
                ("k_eff", twin.tail.k_eff, tail.k_eff),
                ("friction", twin.tail.friction, tail.coulomb),
            )
        ],
        "servo": [_servo_row(one) for one in overlays(day, twin)],
        "swims": as_json(predict(twin, [as_run(one, twin) for one in day.fluid]))["runs"],
    }


def overlays(day: Day, twin: Fish) -> list[Overlay]:
    """The twin's servo and the idealised one on the day's commands, in free run."""
    benches = [as_bench(one, twin) for one in day.motor]
    ideal = twin.servos.get(IDEAL, twin.servos[twin.servo])
    own, other = (
        free_run(described_servo(servo), benches) for servo in (twin.servos[twin.servo], ideal)
    )
    return [
        Overlay(bench, "held out", a[0], b[0])
        for bench, a, b in zip(benches, own, other, strict=True)
    ]


def _servo_row(one: Overlay) -> dict[str, Any]:
    rms = {which: _rms(one.error_deg(which)) for which in ("identified", "idealised")}
    return {"recording": one.bench.name, **{f"{k}_rms_deg": v for k, v in rms.items()}}


def _rms(values: Any) -> float:
    return float(np.sqrt(np.square(values).mean()))
