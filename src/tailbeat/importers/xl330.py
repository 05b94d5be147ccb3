"""Read pendulum logs of a Dynamixel XL330, in the JSON format of Rhoban/bam, as recordings."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput, refuse_existing
from tailbeat.recording import Recording, write_recording

Array = NDArray[np.float64]
XL330_FULL_PWM = 885  # register value of a duty of 1


def convert(log: Path, out: Path, source: str = "") -> Recording:
    """Read a pendulum log and write a recording to `out`, .csv or .parquet. Raises BadInput as
    `import_xl330` and `write_recording` do."""
    refuse_existing(out)
    recording = import_xl330(log, source)
    write_recording(recording, out)
    return recording


def import_xl330(path: str | Path, source: str = "") -> Recording:
    """A pendulum log (JSON of Rhoban/bam) as command, angle and what the servo reported, in SI.

    At angle 0 the pendulum hangs down. `enabled_ratio` is 1 with torque on. The metadata holds the
    gain (the firmware's P register), mass [kg] and arm [m] of the load, supply [V], and `source`:
    who recorded it, in the user's words. An XL330's `load` is its present PWM as an unsigned 16-bit
    count; it becomes a duty, `pwm_ratio`. For other servos its meaning is not known, and it is left
    out. Raises BadInput that names file and field.
    """
    file = Path(path)
    log = _read_log(file)
    names = {
        "command_rad": "goal_position",
        "angle_rad": "position",
        "velocity_rad_s": "speed",
        "voltage_v": "input_volts",
        "enabled_ratio": "torque_enable",
    }
    time = _entries(file, log, "timestamp")
    _check_log_time(file, time)
    columns = {column: _entries(file, log, field) for column, field in names.items()}
    if log.get("motor") == "xl330":
        counts = _entries(file, log, "load")
        columns["pwm_ratio"] = np.where(counts > 32767, counts - 65536, counts) / XL330_FULL_PWM
    meta = {
        "source": source or f"not stated; imported from {file.name}",
        "motor": str(log.get("motor", "not stated")),
        "trajectory": str(log.get("trajectory", "unknown")),
        **{
            key: f"{_header(file, log, field):g}"
            for key, field in (
                ("gain", "kp"),
                ("load_mass_kg", "mass"),
                ("load_arm_m", "length"),
                ("supply_v", "vin"),
            )
        },
    }
    return Recording(file.stem, time, columns, meta)


def _read_log(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise BadInput(f"{file}: no such file; give a JSON log of an XL330 pendulum.")
    try:
        log = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:  # also of a number with thousands of digits
        raise BadInput(f"{file}: not JSON ({error}); give an XL330 pendulum log.") from None
    if not isinstance(log, dict) or not isinstance(log.get("entries"), list):
        raise BadInput(f"{file}: field entries is missing; give an XL330 pendulum log.")
    if len(log["entries"]) < 2:
        raise BadInput(f"{file}: {len(log['entries'])} entries; a recording needs at least 2.")
    return log


def _entries(file: Path, log: dict[str, Any], field: str) -> Array:
    try:
        values = np.array([float(entry[field]) for entry in log["entries"]])
    except (TypeError, ValueError, KeyError):
        raise BadInput(
            f"{file}: field {field} is missing or not a number in some entry; give a finite number."
        ) from None
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values))[0])
        raise BadInput(f"{file}: entry {row + 1}: {field} = {values[row]}; give a finite number.")
    return values


def _header(file: Path, log: dict[str, Any], field: str) -> float:
    try:
        value = float(log[field])
    except (TypeError, ValueError, KeyError):
        value = float("nan")
    if not 0 < value < np.inf:
        raise BadInput(f"{file}: header {field} = {log.get(field)!r}; give a number above 0.")
    return value


def _check_log_time(file: Path, time: Array) -> None:
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        row = int(back[0]) + 1
        raise BadInput(
            f"{file}: entry {row + 1}: timestamp {time[row]} does not come after {time[row - 1]};"
            f" time must rise. Sort the entries or remove the repeated one."
        )
