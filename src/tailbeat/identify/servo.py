"""Servo identification: simulate the angle from the recorded command, and fit it to the encoder's.

tau = clip(kp (command(t - delay) - angle) - kv speed, force_limit) - damping speed, against a known
load. The fit finds the numbers that bring the angle of `shaft.free_run` closest to the recorded
one. Recordings at several gain registers share one set: kp = gain_scale x gain. The divisor of a
datasheet is not used (an XL330's was observed as twice the printed one).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo
from tailbeat.fish.show import stiffening
from tailbeat.identify.glitches import SHAFT, find
from tailbeat.identify.hinges import tail_inertia
from tailbeat.identify.response import STILL
from tailbeat.identify.shaft import Bench, Load, free_run
from tailbeat.identify.space import Parameter
from tailbeat.identify.stretches import check_close, stretches
from tailbeat.recording import Recording, require

Array = NDArray[np.float64]
GRAVITY = 9.80665  # m/s^2
DEVIATION = np.radians(0.1)  # of an angle: about an encoder count (0.088 deg)
COMPARED = 400  # samples of a recording that are compared, about
COUNTED = 100  # independent samples that a recording counts for, chosen: a stroke has about ten
WIDE = 2 * np.pi  # rad: largest allowed angle; no position servo turns further here
MANY = 0.5  # fraction of an angle's samples beyond `WIDE`; above it the column is in degrees
SLOWEST = 0.1  # s between samples, median; further apart they do not show a stroke
FEWEST = 8  # samples with torque on that can tell a sign
LAGS = np.arange(0.0, 0.21, 0.02)  # s by which a servo may be late
AGAINST = 0.5  # correlation with the turned command above which an angle may be mirrored
BLOCK = 0.5  # s over which residuals are correlated, chosen: the time of a slip or a stroke
STEP = 0.02  # finite difference of the intervals in z; the model has kinks at every standstill
PENDULUM = {"load_mass_kg", "load_arm_m"}  # metadata of a pendulum
GEARS = ("load_friction", "stiction")  # fitted on the test bench; the twin cannot compile them

# The paper trained with this ideal servo.
IDEALISED = Servo(kp=800.0, kv=20.0, armature=0.001, damping=0.0, force_limit=1.0, delay=0.0)

# Prior centre, spread, low, high, unit, logarithmic: wide enough for a hobby servo and for a
# robot's joint (factor 4.5 per spread, 2.7 for the limit). kv, friction and the gears' friction
# start from 0.
PRIORS: dict[str, tuple[float, float, float, float, str, bool]] = {
    "kp": (5.0, 2.0, 1e-3, 1e4, "N m/rad", True),
    "kv": (0.0, 0.1, 0.0, 50.0, "N m s/rad", False),
    "armature": (3e-3, 1.5, 1e-6, 1.0, "kg m^2", True),
    "damping": (0.05, 1.5, 1e-5, 20.0, "N m s/rad", True),
    "friction": (0.0, 0.05, 0.0, 5.0, "N m", False),
    "force_limit": (1.5, 1.0, 0.02, 100.0, "N m", True),
    "delay": (0.01, 0.01, 0.0, 0.1, "s", False),
    "damping_off": (0.05, 1.5, 1e-5, 20.0, "N m s/rad", True),
    "load_friction": (0.0, 0.1, 0.0, 0.9, "1", False),
    "stiction": (0.0, 0.1, 0.0, 0.9, "1", False),
}


# ---- recordings ---------------------------------------------------------------------------------


def as_benches(recording: Recording, fish: Fish, kind: str | None = None) -> list[Bench]:
    """`as_bench` of every part of a recording in which time rises. Raises BadInput as it does."""
    return [as_bench(part, fish, kind) for part in stretches(recording)]


def as_bench(recording: Recording, fish: Fish, kind: str | None = None) -> Bench:
    """A recording with its load: `kind` tail, pendulum or nothing; None: as its metadata say.

    Needs `time_s`, `command_rad` and `angle_rad`, and `enabled_ratio` if torque was switched.
    Metadata: `gain` (register); `load_mass_kg` and `load_arm_m` of a pendulum that hangs down at
    angle 0; `load: tail` or `nothing`. Without a load it is the fish's tail. Glitches of the angle
    are left out, and the bench begins at the first good sample. Raises BadInput for a missing
    column, degrees, milliseconds, a command or an angle that never moves, a mirrored angle, or
    wrong metadata.
    """
    command, angle = require(recording, ["command_rad", "angle_rad"])
    _check_radians(recording.name, "command_rad", command)
    if np.mean(np.abs(angle) > WIDE) > MANY:  # before the search for glitches: it knows radians
        _check_radians(recording.name, "angle_rad", angle)
    good, glitches = find(recording, {"angle_rad": SHAFT})
    angle = np.where(good["angle_rad"], angle, np.nan)
    _check_radians(recording.name, "angle_rad", angle)
    enabled = recording.columns.get("enabled_ratio", np.ones_like(angle))
    _check_moves(recording, command, angle, enabled)
    first = int(np.argmax(good["angle_rad"]))
    return Bench(
        recording.name,
        recording.time[first:] - recording.time[first],
        command[first:],
        angle[first:],
        enabled[first:],
        load_of(recording, fish, kind),
        _number(recording, "gain") if "gain" in recording.meta else None,
        tuple(glitches),
    )


def _check_moves(recording: Recording, command: Array, angle: Array, enabled: Array) -> None:
    """Raises BadInput for samples far apart, a command or a shaft that never moves, or an angle
    that runs against the command."""
    name = recording.name
    check_close(recording, SLOWEST)
    if np.ptp(command) < STILL:
        raise BadInput(
            f"{name}: column command_rad never moves; record a chirp or steps (see `tailbeat"
            f" protocol servo`)."
        )
    if np.nanmax(angle) - np.nanmin(angle) < STILL:
        raise BadInput(
            f"{name}: column angle_rad never moves, the command does; check encoder and shaft, and"
            f" record it again."
        )
    driven = np.isfinite(angle) & (enabled > 0.5)
    if driven.sum() > FEWEST and _mirrored(recording.time, command, angle, driven):
        raise BadInput(
            f"{name}: column angle_rad runs against command_rad; turn the sign of one of them."
        )


def _mirrored(time: Array, command: Array, angle: Array, good: NDArray[np.bool_]) -> bool:
    """Whether the angle follows the turned command, and at no lag of a servo the command itself;
    where it is `good`."""
    late = [np.interp(time - lag, time, command)[good] for lag in LAGS]
    moves = [one for one in late if np.ptp(one) > 0 and np.ptp(angle[good]) > 0]
    agree = np.array([np.corrcoef(one, angle[good])[0, 1] for one in moves] or [0.0])
    return bool(-agree.min() > AGAINST and agree.max() < -agree.min() / 2)


def check_driven(benches: Sequence[Bench]) -> None:
    """Raises BadInput if the servo's torque was off in all recordings."""
    if benches and not any((bench.enabled > 0.5).any() for bench in benches):
        raise BadInput(
            f"{benches[0].name}: column enabled_ratio is never 1, also in no other recording: the"
            f" servo's torque was off; record it with torque on."
        )


def _check_radians(name: str, column: str, values: Array) -> None:
    widest = float(np.nanmax(np.abs(values)))
    if widest > WIDE:
        raise BadInput(
            f"{name}: column {column} reaches {widest:.3g}; allowed is {WIDE:.3g} rad, so it looks"
            f" like degrees: convert it to radians."
        )


def load_of(recording: Recording, fish: Fish, kind: str | None = None) -> Load:
    """The load on the shaft: `kind`, else from the metadata, else the fish's tail. Raises BadInput
    for an unknown kind, wrong metadata, or a tail without `k_eff`."""
    meta = recording.meta
    kind = kind or meta.get("load") or ("pendulum" if PENDULUM & meta.keys() else "tail")
    if kind == "pendulum":
        mass, arm = _number(recording, "load_mass_kg"), _number(recording, "load_arm_m")
        return Load(kind, inertia=mass * arm**2, weight=mass * GRAVITY * arm)
    if kind == "nothing":
        return Load(kind)
    if kind != "tail":
        raise BadInput(f"{recording.name}: load {kind!r}; give tail, pendulum or nothing.")
    return tail_load(fish)


def tail_load(fish: Fish) -> Load:
    """The fish's own tail in air, seen at the shaft. Raises BadInput if it has no `k_eff`."""
    k_eff = fish.tail.k_eff
    if k_eff is None:
        raise BadInput(
            f"{fish.name}: tail.k_eff is missing; run `tailbeat identify tail` first, or name the"
            f" load on the shaft with --load."
        )
    tail = fish.tail
    inertia = tail_inertia(fish)
    bend = stiffening(fish)
    return Load("tail", k_eff, k_eff * tail.damping_time, inertia, tail.friction, bend=bend)


def _number(recording: Recording, key: str) -> float:
    try:
        value = float(recording.meta[key])
    except (KeyError, ValueError):
        value = float("nan")
    if not 0 < value < np.inf:
        raise BadInput(
            f"{recording.name}: metadata {key} = {recording.meta.get(key)!r}; give a number above 0"
            f" as a line `# {key}: …`."
        )
    return value


# ---- the fit's parts ----------------------------------------------------------------------------


def servo_space(benches: Sequence[Bench], gears: bool = True) -> tuple[Parameter, ...]:
    """The free numbers for these recordings: one `gain_scale` instead of kp if they state gains,
    `damping_off` if torque was ever off, and the gears' friction with `gears`."""
    names = [name for name in PRIORS if name != "damping_off" or _ever_off(benches)]
    names = [name for name in names if gears or name not in GEARS]
    found = {name: _parameter(name) for name in names}
    reference = gain_reference(benches)
    if reference is not None:
        scaled = {key: getattr(found["kp"], key) / reference for key in ("low", "high", "prior")}
        gain = replace(found["kp"], path="gain_scale", unit="N m/rad per unit", **scaled)
        found = {("gain_scale" if n == "kp" else n): p for n, p in found.items()} | {
            "gain_scale": gain
        }
    return tuple(found.values())


def _parameter(name: str) -> Parameter:
    centre, spread, low, high, unit, log = PRIORS[name]
    return Parameter(name, unit, low, high, centre, spread, log)


def _ever_off(benches: Sequence[Bench]) -> bool:
    return any((bench.enabled < 0.5).any() for bench in benches)


def gain_reference(benches: Sequence[Bench]) -> float | None:
    """The middle gain of the recordings, None if none states a gain. Raises BadInput if only some
    do."""
    gains = [bench.gain for bench in benches]
    if all(gain is None for gain in gains):
        return None
    if any(gain is None for gain in gains):
        lacking = benches[gains.index(None)].name
        raise BadInput(
            f"{lacking}: metadata gain is missing, and other recordings have it; add it as a line"
            f" `# gain: …`."
        )
    return float(np.median([gain for gain in gains if gain is not None]))


def as_servos(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> dict[str, Array]:
    """Candidates (n, p) as the arguments of `free_run`."""
    found = {
        p.path: np.array([p.from_z(c) for c in column])
        for p, column in zip(space, z.T, strict=True)
    }
    none = np.zeros(len(z))
    servo = {name: found.get(name, none) for name in PRIORS}
    servo["damping_off"] = found.get("damping_off", servo["damping"])
    if "gain_scale" in found:
        servo["kp"] = found["gain_scale"][:, None] * np.array([b.gain for b in benches], float)
    return servo


def described_servo(servo: Servo) -> dict[str, Array]:
    """A described servo as the arguments of `free_run`."""
    found = {name: np.array([float(value)]) for name, value in servo.model_dump().items()}
    return {**found, "damping_off": found["damping"], **{g: np.zeros(1) for g in GEARS}}


def compared(bench: Bench) -> NDArray[np.int_]:
    """Indices (c,) of the compared samples: about `COMPARED`, evenly spaced, without glitches."""
    every = np.arange(0, bench.time.size, _thinning(bench))
    return every[bench.good[every]]


def _thinning(bench: Bench) -> int:
    return max(bench.time.size // COMPARED, 1)


def residual_function(
    benches: Sequence[Bench], space: tuple[Parameter, ...]
) -> Callable[[Array], Array]:
    """Batched residuals for `search`: candidates (n, p) in z -> (n, r)."""
    chosen = [compared(bench) for bench in benches]
    weights = [
        np.sqrt(COUNTED / len(bench.time[:: _thinning(bench)])) / DEVIATION for bench in benches
    ]

    def residuals(z: Array) -> Array:
        angles = free_run(as_servos(space, z, benches), benches)
        rows = [
            (angle - bench.angle)[:, own] * weight
            for angle, bench, own, weight in zip(angles, benches, chosen, weights, strict=True)
        ]
        return np.concatenate(rows, axis=1)

    return residuals


def blocks(benches: Sequence[Bench]) -> NDArray[np.int_]:
    """The block of time of each residual of `residual_function` (r,): residuals in one block are
    correlated."""
    found: list[Array] = []
    first = 0
    for bench in benches:
        time = bench.time[compared(bench)]
        own = (time / BLOCK).astype(int)
        found.append(first + own)
        first += int(own[-1]) + 1
    return np.concatenate(found)
