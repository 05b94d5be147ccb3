"""The sign test: before it swims, the robot beats a little and holds one bend.

Servo, IMU and camera must agree on it in direction and size. The test needs no model of the water:
the policy's file says what angle and what yaw rate follow from setpoints (`control.expected`). All
functions are pure; `robot.signs` plays the program. Needs only numpy.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import consistency as signals
from tailbeat.control.actions import PERIOD
from tailbeat.control.expected import Expected
from tailbeat.control.load import OBEYED, TEST_PULL, Motor, bent_pulls, obeyed
from tailbeat.control.observation import wrapped

Array = NDArray[np.float64]
STILL, BEND, BACK = 0.8, 0.6, 0.2  # s: at rest, holding a bend, going back to straight
BEATS = 4
STROKE, HELD = 0.35, 0.5  # rad, at most this share of the range: of the beats, of the bend
SHARE = 0.5
SETTLED = 0.3  # s at the end of the bend in which the load is read
ANSWER = 0.25  # of the expected size: an answer, or its opposite (chosen)
SEEN = 0.008  # m that the tag must move forward beyond its drift: three times a pose's noise
ASKEW = math.radians(55)  # between the tag's heading and its motion: pushes turn 47 (chosen)
DOUBT = 10  # frames, the fewest that a comparison needs


@dataclass(frozen=True)
class Program:
    """Setpoints (k,) [rad], one for each period, and the rows of the beats and of the bend to the
    left; one to the right follows."""

    setpoints: Array
    beats: slice
    bend: slice


@dataclass(frozen=True)
class Answers:
    """What was measured, each over what was expected: 1 is as expected, -1 its opposite, 0 no
    answer; NaN: not known. `stroke` of the motor, `load` on the bent tail, yaw rate of the `imu`
    and the `camera`; by the servo's current the pull of the `left` and the `right` tendon, and the
    share of its setpoints that the servo `obeyed`. `forward` [m] of the tag over its drift, in the
    direction `askew` [rad], positive to the left of its heading."""

    stroke: float
    load: float
    imu: float
    camera: float
    forward: float
    askew: float
    left: float = math.nan
    right: float = math.nan
    obeyed: float = math.nan


def program(band: tuple[float, float], low: float, high: float) -> Program:
    """The test of a fish with this band [Hz] and this range of its motor [rad]."""
    middle, room = (low + high) / 2, SHARE * (high - low) / 2
    frequency = math.sqrt(max(band[0], 0.5) * band[1])
    still, bend, back = (round(one / PERIOD) for one in (STILL, BEND, BACK))
    count = round(BEATS / frequency / PERIOD)
    wave = math.tau * frequency * PERIOD * np.arange(1, count + 1)
    held = min(HELD, room) * np.minimum(np.arange(1, bend + 1) / back, 1.0)
    straight = min(HELD, room) * (1 - np.arange(1, back + 1) / back)
    beats = min(STROKE, room) * np.sin(wave)
    parts = [np.zeros(still), beats, held, straight, -held, -straight]
    edges = np.cumsum([0, *map(len, parts)]).tolist()
    rest = min(max(0.0, low), high) if low <= 0 <= high else middle
    setpoints = np.clip(rest + np.concatenate(parts), low, high)
    return Program(setpoints, slice(edges[1], edges[2]), slice(edges[2], edges[3]))


def answers(plan: Program, rows: Array, expected: Expected, motor: Motor | None = None) -> Answers:
    """Compare the rows (k, 13) of a played program, see `consistency.COLUMNS`. Without a
    `motor` the servo's current says nothing."""
    beats, bend = rows[plan.beats], rows[plan.bend][-round(SETTLED / PERIOD) :]
    asked = plan.setpoints[plan.bend][-len(bend) :]
    wanted = float((asked - bend[:, signals.MODELLED]).mean())
    found = float((asked - bend[:, signals.ANGLE]).mean())
    forward, askew = motion(plan, rows)
    left, right, share = math.nan, math.nan, math.nan
    if motor is not None:
        moving = rows[plan.beats.start :]
        left, right = bent_pulls(moving, expected.shaft, motor)
        share = obeyed(moving, expected.shaft, motor)
    return Answers(
        stroke=signals.gain(beats[:, signals.ANGLE], beats[:, signals.MODELLED], 0.0),
        load=found / wanted if wanted else math.nan,
        imu=_imu(beats, expected),
        camera=_camera(plan, rows, expected),
        forward=forward,
        askew=askew,
        left=left,
        right=right,
        obeyed=share,
    )


def _imu(beats: Array, expected: Expected) -> float:
    taps = len(expected.recoil)
    wanted = _recoil(beats, expected)
    return signals.gain(beats[taps - 1 :, signals.RATE], wanted, 0.0)


def _recoil(rows: Array, expected: Expected) -> Array:
    """The yaw rate [rad/s] that the modelled shaft would give: a stuck encoder hides no answer."""
    return np.convolve(rows[:, signals.MODELLED], np.array(expected.recoil), mode="valid")


def _camera(plan: Program, rows: Array, expected: Expected) -> float:
    """The camera's yaw during the beats, over the integral of the expected yaw rate."""
    taps = len(expected.recoil)
    first, last = plan.beats.start - taps + 1, plan.beats.stop
    part = rows[first:last]
    turned = PERIOD * np.cumsum(_recoil(part, expected))
    times = part[taps - 1 :, signals.TIME]
    frames = signals.distinct(rows)
    stamp = frames[:, signals.STAMP]
    inside = (stamp >= times[0]) & (stamp <= times[-1])
    if inside.sum() < DOUBT:
        return math.nan
    wanted = np.interp(stamp[inside], times, turned)
    return signals.gain(frames[inside, signals.YAW], wanted, 0.0)


def motion(plan: Program, rows: Array) -> tuple[float, float]:
    """Distance [m] that the beats moved the tag beyond the drift seen before them, and its
    direction [rad] from the heading; NaN where too few frames are there."""
    frames = signals.distinct(rows)
    stamp = frames[:, signals.STAMP]
    begin, end = (rows[at, signals.TIME] for at in (plan.beats.start, plan.beats.stop))
    before = frames[(stamp > begin - STILL / 2) & (stamp <= begin)]
    after = frames[(stamp > end) & (stamp <= end + STILL / 2)]
    still = frames[stamp <= begin]
    if min(len(before), len(after)) < DOUBT / 2:
        return math.nan, math.nan
    place = slice(signals.X, signals.Y + 1)
    centre = before[:, signals.STAMP].mean()
    drift = [signals.slope(still[:, signals.STAMP], still[:, k]) for k in (signals.X, signals.Y)]
    away = after[:, place].mean(axis=0) - before[:, place].mean(axis=0)
    away = away - np.array(drift) * (after[:, signals.STAMP].mean() - centre)
    during = frames[(stamp > begin) & (stamp <= end), signals.YAW].mean()
    direction = math.atan2(away[1], away[0])
    return float(np.hypot(*away)), float(wrapped(direction - during))


# ---- what they mean -----------------------------------------------------------------------------


def verdict(found: Answers) -> str:
    """What is wrong and what to do, in one sentence; "" if all agree."""
    if not found.stroke > ANSWER:
        return (
            f"the shaft moved {100 * found.stroke:.0f} % of the stroke: check the servo's drive"
            f" mode, gain and limits with `tailbeat doctor`"
        )
    return _body(found) or _current(found) or _heading(found)


def _body(found: Answers) -> str:
    """What IMU and camera say of the body's answer."""
    imu, camera = _sign(found.imu), _sign(found.camera)
    if (imu, camera) == (1, 1):
        return ""
    if (imu, camera) == (-1, -1):
        return "the tail bends to the wrong side: swap its tendons, or turn the servo's horn over"
    if (imu, camera) == (-1, 1):
        return "the IMU turns the wrong way round: it is upside down; change its mounting"
    if (imu, camera) == (1, -1):
        return "the camera turns the wrong way round: its picture is mirrored; calibrate it again"
    if imu == 0 and camera == 0:
        loose = "its load is missing: check the tendons" if _sign(found.load) < 1 else "is it held?"
        return f"the body does not answer the tail: {loose}"
    if imu == 0:
        return "the IMU does not show the beat: check its mounting and which axis points up"
    return "the camera does not show the beat: check that the tag is fixed to the fish"


def _current(found: Answers) -> str:
    """What the servo's current says."""
    if found.obeyed < OBEYED:
        return (
            f"the servo obeys {100 * found.obeyed:.0f} % of its setpoints: check its horn and its"
            f" encoder, and its settings with `tailbeat doctor`"
        )
    for side, pull in (("left", found.left), ("right", found.right)):
        if pull < TEST_PULL:
            return (
                f"the {side} tendon pulls by {100 * pull:.0f} % of what it should: check that it is"
                f" tight"
            )
    return ""


def _heading(found: Answers) -> str:
    """What the tag's motion says."""
    if math.isnan(found.forward):
        return "the camera lost the tag: check the picture with `tailbeat doctor --camera`"
    if not found.forward > SEEN:
        return (
            f"the fish did not move: {1e3 * found.forward:.0f} mm in {BEATS} beats; is it held, or"
            f" at a wall?"
        )
    if abs(found.askew) > ASKEW:
        side = "left" if found.askew > 0 else "right"
        return (
            f"the fish swims {math.degrees(abs(found.askew)):.0f} degrees to the {side} of its"
            f" tag's heading: turn the tag"
        )
    return ""


def _sign(answer: float) -> int:
    """1 for an answer as expected, -1 for its opposite, 0 for none."""
    return int(answer > ANSWER) - int(answer < -ANSWER)
