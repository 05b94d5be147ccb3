"""Predict recorded swims with a twin, and compare with what was measured."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tailbeat.files import plain
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Swim
from tailbeat.identify.gait import Gait, Track, way
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.runs import Cruise, Run, camera_track, last_beats, repeat, twin_gait

# A prediction settles longer than a fit, and is averaged over more beats: it runs only once.
LONG = Cruise(settle=20, measure=3)
JUDGED = 8.0  # s after the start of a replayed run; the heading is compared there
SETTLED = 0.02  # relative change of speed over the last beats that counts as settled


@dataclass(frozen=True, eq=False)
class Prediction:
    """A run and the twin's prediction. `marker_error` [m]: see the function. `settled`: the twin
    did not diverge, and a cruise reached a steady speed."""

    run: Run
    gait: Gait
    track: Track
    marker_error: float
    settled: bool


def predict(fish: Fish, runs: Sequence[Run]) -> list[Prediction]:
    """Predict every run in one batched call, in the order of `runs`. Nothing is fitted."""
    done = repeat([fish], runs, LONG)[0]
    return [_judge(fish, run, swim) for run, swim in zip(runs, done, strict=True)]


def _judge(fish: Fish, run: Run, swim: Swim) -> Prediction:
    track = camera_track(fish, run, swim)
    gait = twin_gait(fish, run, swim, LONG)
    return Prediction(
        run, gait, track, marker_error(run, gait, track), _settled(run, track) and not swim.diverged
    )


def _settled(run: Run, track: Track) -> bool:
    """Whether the last three beats have the speed of the three before, within 2 % or 1 mm/s. Always
    true of a replayed run."""
    if run.motor is not None:
        return True
    speeds = [
        np.linalg.norm(np.ptp(last_beats(track, run.gait.frequency, 3, skip).pose[[0, -1], :2], 0))
        for skip in (0, 3)
    ]
    limit = max(SETTLED * float(speeds[0]), 0.003 / run.gait.frequency)
    return abs(float(speeds[0] - speeds[1])) < limit


def marker_error(run: Run, gait: Gait, track: Track) -> float:
    """Root mean square error [m]. Of a cruise: the markers' sideways motion at the beat in the head
    frame, phases aligned at the tip. Of a replayed run: the tracked point's position over time; if
    no heading was recorded, the twin's path is first turned onto the recorded one."""
    if run.motor is None:
        assert gait.wave is not None and run.gait.wave is not None
        return float(np.sqrt(np.nanmean(np.abs(gait.wave - run.gait.wave) ** 2) / 2))
    when = run.track.time - run.track.time[0]
    path = np.stack([np.interp(when, track.time, c) for c in track.pose[:, :2].T], axis=1)
    return float(np.sqrt(np.square(path - run.track.pose[:, :2]).sum(axis=1).mean()))


@dataclass(frozen=True)
class PathErrors:
    """Errors of a replayed run. `distance` along the heading [m]; position error (rms) as a
    fraction of it; heading error [deg] after 8 s or at the end, averaged over +-0.1 s.

    Without a recorded heading the distance is over ground, and the heading error is NaN.
    """

    distance: float
    position_error_share: float
    heading_error_deg: float


def path_errors(prediction: Prediction) -> PathErrors:
    """Errors of the twin's path on a replayed run."""
    track, found = prediction.run.track, prediction.track
    when = track.time - track.time[0]
    swum = way(track)
    at = min(JUDGED, float(when[-1]) - 0.1)
    around = np.abs(when - at) <= 0.1
    yaw = np.interp(when[around], found.time, found.pose[:, 2]) - track.pose[around, 2]
    share = prediction.marker_error / max(swum, 1e-9)
    return PathErrors(swum, share, float(np.degrees(yaw.mean())))


def as_json(predictions: Sequence[Prediction]) -> dict[str, Any]:
    """The result of `tailbeat predict` as JSON, in SI except names that end in another unit."""
    return {
        "runs": [row(prediction) for prediction in predictions],
        "speed_mae": speed_mae(predictions),
        "glitches": as_rows(glitch for one in predictions for glitch in one.run.glitches),
    }


def speed_mae(predictions: Sequence[Prediction]) -> float:
    """Mean absolute error of mean speed [m/s]."""
    return float(np.mean([abs(p.gait.speed - p.run.gait.speed) for p in predictions]))


def row(prediction: Prediction) -> dict[str, Any]:
    """One run of `as_json`; None for numbers that need a beat or a heading and have none."""
    found: dict[str, Any] = {
        "recording": prediction.run.name,
        "beat_frequency": prediction.run.gait.frequency,
        "beats": prediction.run.gait.beats,
        "settled": prediction.settled,
        "marker_error": prediction.marker_error,
    }
    if prediction.run.motor is not None:
        found |= asdict(path_errors(prediction))
    for name in ("speed", "stride", "strouhal", "tail_amplitude"):
        found[f"measured_{name}"] = getattr(prediction.run.gait, name)
        found[f"predicted_{name}"] = getattr(prediction.gait, name)
    return {name: plain(value) for name, value in found.items()}
