"""Recordings as runs that a twin repeats.

There are two kinds. A *replayed* run has `motor_angle_rad`: the twin's motor follows it from the
recorded pose, and poses are compared over time. A *cruise* has only marker tracks: the crank turns
at the beat frequency of the tracks, from the recorded speed. The steady gait is compared, so the
crank's unknown phase has no effect.

A replayed run needs no beat: without a steady one, the numbers of its gait are NaN. It needs no
`yaw_rad` either: still water has no direction. The twin then starts along the path's first
direction, and its path is turned onto the recorded one (`camera_track`). A run that starts while
moving is assumed to start nose first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, Swim, replay_command, swim
from tailbeat.fish.twin import Options, Twin, compile_twin
from tailbeat.identify.clean import clean_swim
from tailbeat.identify.gait import (
    Gait,
    Track,
    beat_frequency,
    beat_signal,
    measure_gait,
    steady_beat,
)
from tailbeat.identify.glitches import Glitch
from tailbeat.identify.launch import launch_of
from tailbeat.identify.stretches import check_close, stretches
from tailbeat.identify.tag_pose import root_pose, tracked_pose
from tailbeat.recording import Recording, markers, require

Array = NDArray[np.float64]
SAMPLE = 0.02  # s between samples of a twin's run
FIRST_WAY = 1.0  # s; their mean direction is the first heading if none was recorded
SHORTEST = 0.5  # s of a replayed run, whose errors are those of a path (chosen)
WRONG_UNIT = 0.5  # fraction of angles beyond the motor's range that is no glitch any more (chosen)
APART = 0.5  # s between samples, above which no beat is seen (chosen; 20 ms are usual)
REPLAYED = Options(replayed=True)


@dataclass(frozen=True)
class Cruise:
    """How long a cruise is simulated: beats to settle, then beats to measure."""

    settle: int = 5
    measure: int = 2


@dataclass(frozen=True, eq=False)
class Run:
    """A checked recording: its track and gait; `motor` (k,) [rad], None for a cruise; `launch` (3,)
    surge, sway [m/s] and yaw rate [rad/s] at the start, if stated; `glitches` that were left out of
    so many `rows`. A cruise has a heading and a beat; a replayed run may lack either."""

    name: str
    track: Track
    gait: Gait
    motor: Array | None
    from_rest: bool
    launch: Array | None = None
    glitches: tuple[Glitch, ...] = ()
    rows: int = 0


def as_runs(recording: Recording, fish: Fish) -> list[Run]:
    """`as_run` of every part of a recording in which time rises. Raises BadInput as it does."""
    return [as_run(part, fish) for part in stretches(recording)]


def as_run(recording: Recording, fish: Fish) -> Run:
    """A recording without its glitches, checked against a fish. Raises BadInput with the reason."""
    check_close(recording, APART)
    if "motor_angle_rad" in recording.columns:  # a wrong unit is no glitch
        check_motor(recording, fish, recording.columns["motor_angle_rad"], most=WRONG_UNIT)
    given = recording.time.size
    recording, glitches = clean_swim(recording)
    motor = recording.columns.get("motor_angle_rad")
    lasts = float(recording.time[-1] - recording.time[0])
    if motor is not None and lasts < SHORTEST:
        raise BadInput(
            f"{recording.name}: lasts {lasts:.2f} s; a swim lasts {SHORTEST:g} s or more. Leave"
            f" this one out."
        )
    if motor is None and fish.motor.kind != "crank":
        raise BadInput(
            f"{recording.name}: column motor_angle_rad is missing; {fish.name} has a servo, so give"
            f" a recording of its angle."
        )
    pose = _recorded_pose(recording, needs_yaw=motor is None)
    track = Track(recording.time, pose, *_marker_tracks(recording, fish))
    if motor is None:
        _check_tip(recording, fish, track)
        frequency = beat_frequency(track.time, beat_signal(track), fish.band, recording.name)
    else:
        check_motor(recording, fish, motor)
        frequency = steady_beat(track.time, np.sin(motor), fish.band)
    gait, launch = measure_gait(track, frequency), launch_of(recording, fish)
    return Run(recording.name, track, gait, motor, _from_rest(track), launch, glitches, given)


def _recorded_pose(recording: Recording, needs_yaw: bool) -> Array:
    """x, y [m] and unwrapped yaw [rad] (k, 3); the yaw is NaN if a replayed run has none."""
    x, y = require(recording, ["x_m", "y_m"])
    if needs_yaw or "yaw_rad" in recording.columns:
        yaw = np.unwrap(require(recording, ["yaw_rad"])[0])
    else:
        yaw = np.full_like(x, np.nan)
    return np.stack([x, y, yaw], axis=1)


def _check_tip(recording: Recording, fish: Fish, track: Track) -> None:
    """Raises BadInput for a cruise without the fin tip, from which its beat is read."""
    name = f"marker{fish.markers[tip_index(fish)].name}_x_m" if fish.markers else "marker…_x_m"
    if track.markers is None or np.isfinite(track.markers[:, track.tip, 0]).mean() < 0.5:
        raise BadInput(
            f"{recording.name}: column {name} (the fin tip) is missing or unseen in over half of"
            f" the frames; a swim without motor_angle_rad needs it."
        )


def check_motor(recording: Recording, fish: Fish, motor: Array, most: float = 0.0) -> None:
    """Raises BadInput if over the fraction `most` of `motor` (k,) [rad] is beyond its range."""
    if fish.motor.range is None:
        return
    low, high = fish.motor.range
    row = int(np.argmax(np.maximum(motor - high, low - motor)))
    if np.mean((motor < low) | (motor > high)) > most:
        raise BadInput(
            f"{recording.name}: column motor_angle_rad, row {row + 1}: {motor[row]:.3f} is outside"
            f" motor.range {low:.3f} to {high:.3f} of {fish.name}; check its unit and zero."
        )


def _marker_tracks(recording: Recording, fish: Fish) -> tuple[Array | None, int]:
    """Marker tracks in the description's order, and the index of the rearmost as the tip."""
    tracks, indices = markers(recording)
    column = {str(index): i for i, index in enumerate(indices)}
    if not any(marker.name in column for marker in fish.markers):
        return None, -1
    unseen = np.full((recording.time.size, 2), np.nan)
    ordered = [
        tracks[:, column[marker.name]] if marker.name in column else unseen
        for marker in fish.markers
    ]
    return np.stack(ordered, axis=1), tip_index(fish)


def tip_index(fish: Fish) -> int:
    """Index of the marker nearest the fin's rear edge."""
    return int(np.argmin([marker.position[0] for marker in fish.markers]))


def _from_rest(track: Track) -> bool:
    """Whether the first tenth of the track is slower than a quarter of its fastest tenth."""
    marks = track.pose[:: max(track.time.size // 10, 2), :2]
    speeds = np.linalg.norm(np.diff(marks, axis=0), axis=1)
    return bool(speeds.size and speeds[0] < 0.25 * speeds.max())


def repeat(
    fishes: Sequence[Fish], runs: Sequence[Run], cruise: Cruise = Cruise(), threads: int = 0
) -> list[list[Swim]]:
    """Every fish repeats every run in one batched call; result[i][j] is fish i on run j."""
    twins = [compile_twin(fish, REPLAYED) for fish in fishes]
    step = twins[0].model.opt.timestep
    every = max(round(SAMPLE / step), 1)
    plans = [_plan(twins[0], run, cruise) for run in runs]
    found = swim(
        [twin for twin in twins for _ in runs],
        [start for _ in twins for start, _ in plans],
        [command for _ in twins for _, command in plans],
        every,
        threads,
    )
    return [found[i * len(runs) : (i + 1) * len(runs)] for i in range(len(twins))]


def _plan(twin: Twin, run: Run, cruise: Cruise) -> tuple[Start, Array]:
    """Where the twin starts a run, and its motor commands."""
    step = twin.model.opt.timestep
    if run.motor is None:
        beats = cruise.settle + cruise.measure + 0.1
        angle = 2 * np.pi * run.gait.frequency * np.arange(0, beats / run.gait.frequency, step)
        velocity = np.array([run.gait.speed, 0.0, 0.0])
        start = Start(np.zeros(3), velocity)
    else:
        time = np.arange(0, run.track.time[-1] - run.track.time[0] + SAMPLE, step)
        # A cubic: linear interpolation at 60 frames/s loses half a percent of a 2 Hz beat.
        curve = CubicSpline(run.track.time - run.track.time[0], run.motor)
        angle = curve(np.minimum(time, run.track.time[-1] - run.track.time[0]))
        start = Start(root_pose(twin.fish, _first_pose(run)), _first_velocity(run))
    rate = (angle[1] - angle[0]) / step
    return replace(start, motor=float(angle[0]), motor_speed=float(rate)), replay_command(
        twin, angle
    )


def _first_pose(run: Run) -> Array:
    """The recorded pose at the start; without a heading, along the path of the first second."""
    x, y, yaw = run.track.pose[0]
    if not run.track.has_heading:
        vx, vy, _ = _drift(run.track, FIRST_WAY)
        yaw = np.arctan2(vy, vx)
    return np.array([x, y, yaw])


def _first_velocity(run: Run) -> Array:
    """Velocity at the start: as stated, else zero from rest, else a linear fit to the first 0.2 s,
    or to the first second if no heading was recorded."""
    if run.launch is not None:
        surge, sway, turn = run.launch
        yaw = _first_pose(run)[2]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.array([cos * surge - sin * sway, sin * surge + cos * sway, turn])
    if run.from_rest:
        return np.zeros(3)
    return _drift(run.track, 0.2 if run.track.has_heading else FIRST_WAY)


def _drift(track: Track, seconds: float) -> Array:
    """Mean velocity (x, y [m/s], yaw [rad/s]) of the first `seconds`; an unknown yaw rate is 0."""
    first = track.time <= track.time[0] + seconds
    if first.sum() < 3:
        return np.zeros(3)
    fit = np.polyfit(track.time[first], np.nan_to_num(track.pose[first]), 1)
    return np.asarray(fit[0])


def camera_track(fish: Fish, run: Run, done: Swim, marked: bool = True) -> Track:
    """A twin's run, as the camera of the recorded one would give it; its markers, which take a
    fifth of a swim's time, only if `marked`.

    Without a recorded heading the path is turned about its first position onto the recorded path
    (least squares), and the yaw is NaN like the recording's.
    """
    track = twin_track(fish, done, marked)
    if run.track.has_heading:
        return track
    turn, first = _turn_onto(run.track, track), track.pose[0, :2]
    path = first + (track.pose[:, :2] - first) @ turn
    markers = None if track.markers is None else first + (track.markers - first) @ turn
    pose = np.column_stack([path, np.full(len(path), np.nan)])
    return Track(track.time, pose, markers, track.tip)


def _turn_onto(recorded: Track, track: Track) -> Array:
    """Rotation (2, 2), for rows, of a twin's path about its first position onto the recorded."""
    when = recorded.time - recorded.time[0]
    wanted = recorded.pose[:, :2] - recorded.pose[0, :2]
    own = track.pose[:, :2] - track.pose[0, :2]
    own = np.stack([np.interp(when, track.time, c) for c in own.T], axis=1)
    cross = float((own[:, 0] * wanted[:, 1] - own[:, 1] * wanted[:, 0]).sum())
    angle = np.arctan2(cross, float((own * wanted).sum()))
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def twin_track(fish: Fish, done: Swim, marked: bool = True) -> Track:
    """A twin's run as a track: pose of the tracked point, and markers if `marked`."""
    shown = marked and bool(fish.markers)
    seen = done.markers[..., :2] if shown else None
    tip = tip_index(fish) if shown else -1
    return Track(done.time, tracked_pose(fish, done.qpos[:, :3]), seen, tip)


def twin_gait(
    fish: Fish, run: Run, done: Swim, cruise: Cruise = Cruise(), marked: bool = True
) -> Gait:
    """The twin's gait over the same span as the recording's: a cruise's last beats, or all. Of its
    body wave only if `marked`."""
    track = camera_track(fish, run, done, marked)
    if run.motor is not None:
        return measure_gait(track, run.gait.frequency)
    return measure_gait(last_beats(track, run.gait.frequency, cruise.measure), run.gait.frequency)


def last_beats(track: Track, frequency: float, beats: int, skip: int = 0) -> Track:
    """The last `beats` beats of `frequency` [Hz], without the `skip` beats at the track's end."""
    period = track.time[1] - track.time[0]
    stop = track.time.size - round(skip / frequency / period)
    return track.cut(max(stop - round(beats / frequency / period) - 1, 0), stop)
