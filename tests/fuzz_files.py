"""Files of every type for the fuzz tests, what reads each, and how they are damaged."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz import LONG

ODD_CONTENTS = (
    "nan", "inf", "-inf", "1e300", "-1", "0", "-0.0", "1e-300", "9" * 30, "null", "true", "[]",
    "{}", '""', '"\\ud800"', f'"{LONG}"', '"NaN"', "\x00", "\ufeff", "1" * 5000, "-", "1e",
    "[[[[[]]]]]",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
STRING = re.compile(rb'"[^"\n]*"')


@dataclass(frozen=True)
class Damage:
    """One change: how, where (a fraction of the file), and what is put in."""

    how: str
    where: float
    what: str


def damaged(data: bytes, damage: Damage) -> bytes:
    """The bytes with this change."""
    return WAYS[damage.how](data, damage.where, damage.what.encode("utf-8", "surrogatepass"))


def _at(data: bytes, where: float) -> int:
    return int(where * len(data))


def _replaced(pattern: re.Pattern[bytes]) -> Callable[[bytes, float, bytes], bytes]:
    def change(data: bytes, where: float, what: bytes) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return data + what
        one = found[int(where * len(found))]
        return data[: one.start()] + what + data[one.end() :]

    return change


def _flipped(data: bytes, where: float, what: bytes) -> bytes:
    at = _at(data, where)
    return data[:at] + bytes([data[at] ^ (1 << len(what) % 8)]) + data[at + 1 :] if data else data


def _line(times: int) -> Callable[[bytes, float, bytes], bytes]:
    def change(data: bytes, where: float, what: bytes) -> bytes:
        lines = data.split(b"\n")
        at = int(where * len(lines))
        return b"\n".join([*lines[:at], *[lines[at]] * times, *lines[at + 1 :]])

    return change


WAYS: dict[str, Callable[[bytes, float, bytes], bytes]] = {
    "cut": lambda data, where, what: data[: _at(data, where)],
    "inserted": lambda data, where, what: (
        data[: _at(data, where)] + what + data[_at(data, where) :]
    ),
    "flipped": _flipped,
    "number": _replaced(NUMBER),
    "another number": _replaced(NUMBER),  # twice, for it is what finds most
    "text": _replaced(STRING),
    "line gone": _line(0),
    "line twice": _line(2),
    "hole": lambda data, where, what: (
        data[: _at(data, where)] + bytes(64) + data[_at(data, where) + 64 :]
    ),
    "nested": lambda data, where, what: b"[" * 50_000 + data,
    "begun with": lambda data, where, what: what + data,
}


# ---- the files ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """A type of file: how a whole one is written into a folder, the file's path in it that is
    damaged, and the verbs that read it. `after` is done to the folder after the damage."""

    write: Callable[[Path], None]
    path: str
    verbs: tuple[str, ...]
    after: Callable[[Path], None] = lambda folder: None


def fish(folder: Path) -> None:
    """A fish, as shipped."""
    from tailbeat.fish.store import fish_path

    (folder / "a.toml").write_bytes(fish_path("pulley-fish-pool").read_bytes())


def policy(folder: Path) -> None:
    """The shipped policy, with its contract in plain JSON: numbers in it are found."""
    from tailbeat.control.policy import shipped

    (folder / "a.onnx").write_bytes(shipped()["pulley-fish-pool-generator"].read_bytes())


def contract(folder: Path) -> None:
    """The same, with what its metadata say in a file of its own."""
    import onnx

    policy(folder)
    metadata = {one.key: one.value for one in onnx.load(str(folder / "a.onnx")).metadata_props}
    parts = {key: json.loads(text) for key, text in metadata.items()}
    (folder / "contract.json").write_text(json.dumps(parts))


def signed(folder: Path) -> None:
    """Put what the file says back into the policy, with digests that fit: they refuse no damage."""
    import onnx

    from tailbeat.control.policy import KEY, _digests

    text = (folder / "contract.json").read_text("utf-8", "replace")
    try:
        parts = {key: json.dumps(part) for key, part in json.loads(text).items()}
        content = json.loads(text)[KEY]["contract"]
        parts[KEY] = json.dumps({"contract": content, "digests": _digests(content)})
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError):
        parts = {KEY: text}
    model = onnx.load(str(folder / "a.onnx"))
    onnx.helper.set_model_props(model, parts)
    onnx.save(model, str(folder / "a.onnx"))


def recording(end: str) -> Callable[[Path], None]:
    """Thirty seconds of a swim, with what every reader wants."""

    def write(folder: Path) -> None:
        import numpy as np

        from tailbeat.recording import Recording, write_recording

        time = np.arange(1500, dtype=np.float64) / 50
        wave = 0.3 * np.sin(9 * time)
        names = (
            "command_rad",
            "motor_angle_rad",
            "angle_rad",
            "torque_nm",
            "yaw_rad",
            "yaw_rate_rad_s",
        )
        columns = dict.fromkeys(names, wave) | {"x_m": -0.02 * time, "y_m": 0.01 * wave}
        columns |= {
            f"marker{k}_{axis}_m": -0.1 * k + 0.01 * wave for k in range(6) for axis in "xy"
        }
        meta = {"gain": "800", "load": "nothing", "source": "made"}
        write_recording(Recording("a", time, columns, meta), folder / f"a.{end}")

    return write


def log(folder: Path) -> None:
    """A second of a drive's log."""
    from tailbeat.robot.log import COLUMNS, start

    written = start(folder / "a.mcap", {"policy": "p"})
    for k in range(50):
        numbers = {name: 0.01 * k + i for i, name in enumerate(COLUMNS)}
        row = {"time_s": 100 + 0.02 * k, **numbers, "observation": [0.5] * 24, "action": [0.0] * 6}
        written.put({**row, "decided_on": [0.1] * 18, "state": "run", "reason": "swimming"})
    written.close()


def calibration(folder: Path) -> None:
    """A camera that is known."""
    from camera_views import true_calibration
    from tailbeat.vision.calibration import write_calibration

    write_calibration(folder / "a.json", true_calibration())


def views(folder: Path) -> None:
    """What `calibrate` reads."""
    from tailbeat.emulators.lab import pictures

    pictures(folder / "lab", 8, seed=3)


def posterior(folder: Path) -> None:
    """A fish and its posterior of a few draws."""
    import numpy as np

    from tailbeat.fish.store import digest, load_fish
    from tailbeat.identify import posterior as known

    fish(folder)
    mine = load_fish(folder / "a.toml")
    names = known.Posterior(
        mine.name, digest(mine), ("zones.*.kutta",), ("",), np.ones((4, 1)), ("a",), ("b",), None
    )
    known.write(folder / "a-posterior.parquet", names)


def key(folder: Path) -> None:
    """A key."""
    from tailbeat.link.datagrams import make_key

    make_key(folder / "a.key")


def fishsim(folder: Path) -> None:
    """Markers in pixels."""
    rows = [",".join(f"{900 + 90 * k + i},{500 - 20 * k + i}" for k in range(9)) for i in range(60)]
    (folder / "a.csv").write_text("\n".join(rows))


def pendulum(folder: Path) -> None:
    """A servo's log of Rhoban/bam."""
    entry = {"goal_position": 0.1, "position": 0.1, "speed": 0.0, "input_volts": 7.4, "load": 3,
             "torque_enable": True, "temp": 30}  # fmt: skip
    entries = [{"timestamp": 0.01 * k, **entry} for k in range(20)]
    held = {"kp": 32, "mass": 0.1, "length": 0.1, "vin": 7.4, "motor": "xl330", "entries": entries}
    (folder / "a.json").write_text(json.dumps(held))


def evaluation(folder: Path) -> None:
    """An evaluation's folder with two swims."""
    import numpy as np

    from tailbeat.evaluate.runs import Runs
    from tailbeat.evaluate.store import save

    pose = np.linspace(0, 1, 240, dtype=np.float32).reshape(1, 80, 3).repeat(2, axis=0)
    one, whole = np.ones(2, np.float32), np.ones(2, np.int64)
    swims = Runs(
        pose, pose[..., :2], pose[..., 0], pose[:, 1:, 0], 79 * whole, one > 0, one < 0, one,
        np.zeros((2, 80, 9), np.float32), 0 * whole, one, one,
    )  # fmt: skip
    save(swims, folder / "runs" / "undisturbed.000.npz")
    held = {"policy": "p", "actions": "generator", "band": [1, 4], "training": {}, "waters": 1,
            "twin": "pulley-fish", "fish": "pulley-fish", "fish_digest": "0", "water": "full",
            "seed": 0, "episodes": 1, "walls": [5.5, 2.7],
            "conditions": {"undisturbed": 1}}  # fmt: skip
    (folder / "run.json").write_text(json.dumps(held))


CALIBRATE = (
    "calibrate --views lab/views --survey lab/survey.csv --picture lab/pool.png --out a.json"
)
KINDS = {
    "fish": Kind(fish, "a.toml", (
        "protocol tail --fish a.toml --out out", "show a.toml --json out.json",
        "policy try pulley-fish-pool-generator --fish a.toml --targets 1",
    )),
    "policy": Kind(policy, "a.onnx", (
        "policy show a.onnx", "policy diff pulley-fish-pool-generator a.onnx",
    )),
    "contract": Kind(contract, "contract.json", (
        "policy show a.onnx", "doctor --policy a.onnx --key a.key",
    ), signed),
    "csv": Kind(recording("csv"), "a.csv", (
        "predict a.csv --fish pulley-fish --json out.json",
        "coverage a.csv --against a.csv --fish pulley-fish",
        "import table a.csv --map time=time_s,angle=angle_rad --out out.csv",
        "identify tail a.csv --fish pulley-fish --out out.toml",
        "record fluid --fish pulley-fish --commands a.csv --out out",
    )),
    "parquet": Kind(recording("parquet"), "a.parquet", (
        "predict a.parquet --fish pulley-fish --json out.json",
        "import table a.parquet --map time=time_s,angle=angle_rad --out out.csv",
    )),
    "log": Kind(log, "a.mcap", (
        "export a.mcap --out out.csv",
        "station --replay a.mcap --page nowhere",
    )),
    "calibration": Kind(calibration, "a.json", (
        "track --camera none.mp4 --calibration a.json --seconds 1",
        "doctor --camera none.mp4 --calibration a.json",
    )),
    "survey": Kind(views, "lab/survey.csv", (CALIBRATE,)),
    "picture": Kind(views, "lab/pool.png", (CALIBRATE,)),
    "view": Kind(views, "lab/views/01.png", (CALIBRATE,)),
    "posterior": Kind(posterior, "a-posterior.parquet", (
        "show a.toml", "train --fish a.toml --out run --physics posterior --device none",
    )),
    "key": Kind(key, "a.key", (
        "emulate --key a.key --robot nowhere", "doctor --key a.key",
    )),
    "fishsim": Kind(fishsim, "a.csv", ("import fishsim a.csv --out out.csv",)),
    "pendulum": Kind(pendulum, "a.json", (
        "import xl330 a.json --out out.csv",
        "import table a.json --map time=timestamp,angle=position --out out.parquet",
    )),
    "evaluation": Kind(evaluation, "run.json", ("report .",)),
    "swims": Kind(evaluation, "runs/undisturbed.000.npz", (
        "report .", "predict runs/undisturbed.000.npz --fish pulley-fish",
    )),
}  # fmt: skip
