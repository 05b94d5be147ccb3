"""Fluid identification: which coefficients make the twin swim as the recordings do?

Residuals are speed and body wave of a cruise, and poses over time of a replayed run. They are in
units of their standard deviations. These are chosen once for every fish (`SIGMA`), and not tuned to
a result.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat.fish.description import COEFFICIENTS, Fish
from tailbeat.fish.rollout import Swim
from tailbeat.fish.store import with_values
from tailbeat.identify.gait import Track, measure_gait, surge
from tailbeat.identify.runs import Cruise, Run, camera_track, last_beats, repeat
from tailbeat.identify.space import Parameter, sensitivity
from tailbeat.identify.uncertain import uncertain_parameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sigma:
    """Standard deviations of the residuals, all chosen.

    `wave` is the effect of perspective on markers at two heights: in the crank fish's tracks,
    neighbours at different heights are 20 mm too far apart. The others are about a camera's
    resolution.
    """

    speed: float = 0.002  # m/s, of a cruise's mean speed
    drift: float = 0.003  # m/s, between the last beats of a cruise and those before
    wave: float = 0.01  # m, of a marker's complex amplitude, shared over the markers
    yaw: float = 0.014  # rad, of the heading's complex amplitude and of a pose in time
    position: float = 0.01  # m, of a pose in time


SIGMA = Sigma()
SAMPLES = 60  # poses compared per replayed run
FIRST_POSITION, FIRST_YAW = 0.003, 0.01  # m, rad: standard error of the first frame, chosen
HOLE = 2.5  # times the median interval: in a longer gap nothing is compared
START_WEIGHT = 4.0  # squared error at the start over that at the end (paper)

# Prior centre, spread of ln(value), and range per coefficient. No ellipsoid in water is outside the
# range: a blunt drag above 2 is a C_d of 4; thin-foil theory gives a Kutta factor of about pi at
# most, and unsteady motion does not double it. The lift of a foil that turns, 1/4 pi rho a chord^2
# span u w, is a Magnus factor of 3/2 a chord / thickness: 26 for a fin of 70 x 2 mm with half the
# slope of a section. Centres are the engine's defaults; those of drag are for smooth bodies.
COEFFICIENT_PRIORS: dict[str, tuple[float, float, float, float]] = {
    "blunt": (0.4, 0.6, 0.02, 2.0),
    "slender": (0.15, 1.0, 0.005, 5.0),
    "angular": (1.5, 0.8, 0.05, 20.0),
    "kutta": (1.5, 0.8, 0.01, 6.3),
    "magnus": (2.0, 1.2, 0.01, 60.0),
}
# Lift astern is between the bare engine's (1) and thin-aerofoil theory's (-1). The blending speed
# is a slow fin's (both chosen).
EDGE_PRIORS = (
    Parameter("trailing_edge.speed", "m/s", 0.005, 0.2, 0.03, 0.7),
    Parameter("trailing_edge.reverse", "1", -1.0, 1.0, -0.5, 0.5, log=False),
)
# Of the added mass across a part, the fraction that acts along it: 0 for a thin plate, 0.15 for an
# ellipsoid of the pulley fish's head (Lamb, art. 114), 1 for a sphere. The spread is chosen.
ALONG_PRIOR = Parameter("added_along", "1", 0.0, 0.9, 0.15, 0.15, log=False)
# Without added inertia the coefficients must replace it (the paper's fin has a Kutta factor of 10
# and an angular one of 18): upper limits are higher by this factor, chosen.
STAND_IN = 4.0
# Standard deviations by which a number without effect changes the residuals, all together (chosen).
INSENSITIVE = 0.05


def fluid_space(fish: Fish, zones: int) -> tuple[Parameter, ...]:
    """The free numbers: five coefficients, one set for all zones (`zones` 1) or one for each (3).
    The trailing edge's are added if the fish has one, the fraction of added mass along the parts if
    it is below 1, and those that the description lists as uncertain. Raises BadInput if an
    uncertain number is outside its range."""
    groups = ["*"] if zones == 1 else list(fish.zones)
    room = 1.0 if fish.added_inertia > 0 else STAND_IN
    found = [
        Parameter(f"zones.{zone}.{name}", "1", low, high * room, centre, spread * np.sqrt(room))
        for zone in groups
        for name in COEFFICIENTS
        for centre, spread, low, high in [COEFFICIENT_PRIORS[name]]
    ]
    if fish.trailing_edge is not None:
        found += EDGE_PRIORS
    listed = [extra.field for extra in fish.uncertain]
    if fish.added_inertia > 0 and fish.added_along < 1 and ALONG_PRIOR.path not in listed:
        found.append(ALONG_PRIOR)
    return (*found, *uncertain_parameters(fish))


def apply(fish: Fish, found: dict[str, float]) -> Fish:
    """The fish with values set by dotted path, in SI; `zones.*.kutta` sets every zone's."""
    single: dict[str, float] = {}
    for path, value in found.items():
        names = fish.zones if "*" in path else [""]
        single.update({path.replace("*", zone): value for zone in names})
    return with_values(fish, single)


def with_row(fish: Fish, paths: Iterable[str], row: Array) -> Fish:
    """The fish with the values `row` (p,) at `paths`, as in `apply`."""
    return apply(fish, dict(zip(paths, map(float, row), strict=True)))


def residual_function(
    fish: Fish,
    runs: Sequence[Run],
    space: tuple[Parameter, ...],
    start_weight: bool | None = None,
    cruise: Cruise = Cruise(),  # noqa: B008 (frozen)
) -> Callable[[Array], Array]:
    """Batched residuals for `search`: candidates (n, p) in z -> (n, r).

    `start_weight`: whether the start of a replayed run counts four times its end (None: only if it
    starts from rest). Residuals are in standard deviations (`SIGMA`), infinite if a twin diverges.
    """
    return partial(
        _residuals, fish, (*runs, *forward_checks(fish, runs)), space, start_weight, cruise
    )


def owners(fish: Fish, runs: Sequence[Run]) -> NDArray[np.int_]:
    """The number of the run of each residual (r,) of `residual_function`; forward checks come after
    the runs."""
    everything = (*runs, *forward_checks(fish, runs))
    done = repeat([fish], everything)[0]
    sizes = [
        _compare(fish, run, one, None, Cruise()).size
        for run, one in zip(everything, done, strict=True)
    ]
    return np.repeat(np.arange(len(sizes)), sizes)


def forward_checks(fish: Fish, runs: Sequence[Run]) -> list[Run]:
    """Cruises that were not recorded, at half the slowest recorded beat: from rest, and with a
    trailing edge also launched backward.

    They are no data: a beating fish is known not to swim backward. The engine's velocity half of
    added mass pulls a beating fin rearwards, and its even lift keeps a launched fish in a backward
    gait (docs/explain/twin.md). Replayed swims already show what a launched fish does.
    """
    cruises = [run for run in runs if run.motor is None]
    if not cruises:
        return []
    slowest = min(cruises, key=lambda run: run.gait.frequency)
    beat = slowest.gait.frequency / 2
    launches = (0.0,) if fish.trailing_edge is None else (0.0, -0.1)
    return [
        replace(
            slowest,
            name=f"forward from {launch:g} m/s",
            gait=replace(slowest.gait, frequency=beat, speed=launch, wave=None),
        )
        for launch in launches
    ]


def _residuals(
    fish: Fish,
    runs: tuple[Run, ...],
    space: tuple[Parameter, ...],
    start_weight: bool | None,
    cruise: Cruise,
    z: Array,
) -> Array:
    fishes = [
        apply(fish, {p.path: p.from_z(c) for p, c in zip(space, row, strict=True)}) for row in z
    ]
    swims = repeat(fishes, runs, cruise)
    rows = [
        np.concatenate(
            [_compare(f, r, done, start_weight, cruise) for r, done in zip(runs, s, strict=True)]
        )
        for f, s in zip(fishes, swims, strict=True)
    ]
    return np.stack(rows)


def _compare(fish: Fish, run: Run, done: Swim, start_weight: bool | None, cruise: Cruise) -> Array:
    """Residuals of one run, all infinite if the twin diverged."""
    with np.errstate(all="ignore"):
        track = camera_track(fish, run, done, marked=run.motor is None)
        if run.motor is None:
            found = _compare_cruise(run, track, cruise)
        else:
            weigh = run.from_rest if start_weight is None else start_weight
            found = _compare_poses(run, track, weigh)
    return np.full_like(found, np.inf) if done.diverged else found


def _compare_cruise(run: Run, track: Track, cruise: Cruise) -> Array:
    """Speed, its drift, body wave and heading wave of a cruise."""
    last = last_beats(track, run.gait.frequency, cruise.measure)
    before = last_beats(track, run.gait.frequency, cruise.measure, skip=cruise.measure)
    gait = measure_gait(last, run.gait.frequency)
    if run.gait.wave is None:  # a forward check
        return np.array([min(gait.speed, 0.0) / SIGMA.position])
    assert gait.wave is not None
    seen = np.isfinite(run.gait.wave) & _behind(run)
    wave = (gait.wave - run.gait.wave)[seen] / SIGMA.wave / np.sqrt(seen.sum())
    yaw = (gait.yaw_wave - run.gait.yaw_wave) / SIGMA.yaw
    speed = (gait.speed - run.gait.speed) / SIGMA.speed
    drift = (gait.speed - surge(before).mean()) / SIGMA.drift
    return np.concatenate([[speed, drift, yaw.real, yaw.imag], wave.real, wave.imag])


def _behind(run: Run) -> NDArray[np.bool_]:
    """Markers that move with the tail: their stroke is over 5 % of the tip's."""
    assert run.gait.wave is not None
    return np.abs(run.gait.wave) > 0.05 * abs(run.gait.wave[run.track.tip])


def _compare_poses(run: Run, track: Track, weigh_start: bool) -> Array:
    """Pose errors at `SAMPLES` times of a replayed run, without the first pose's own error.

    Without a recorded heading only positions are compared, after any turn of the first pose.
    """
    span = run.track.time[-1] - run.track.time[0]
    time = np.linspace(span / SAMPLES, min(span, track.time[-1]), SAMPLES)
    scale = np.array([SIGMA.position, SIGMA.position, SIGMA.yaw])
    weight = np.linspace(START_WEIGHT, 1.0, SAMPLES) if weigh_start else np.ones(SAMPLES)
    kept = _recorded(time, run.track.time - run.track.time[0])
    time, weight = time[kept], weight[kept]
    measured = _at(time, run.track.time - run.track.time[0], run.track.pose)
    weight = np.sqrt(weight / weight.mean())[:, None] / scale
    error = ((_at(time, track.time, track.pose) - measured) * weight).ravel()
    way = measured - run.track.pose[0]
    if run.track.has_heading:
        first = FIRST_POSITION, FIRST_POSITION, FIRST_YAW
        return without_first_pose(error, way, weight, first)
    known = error.reshape(-1, 3)[:, :2].ravel()
    return without_first_pose(known, way, weight[:, :2], (FIRST_POSITION, FIRST_POSITION, np.pi))


def _recorded(time: Array, when: Array) -> NDArray[np.bool_]:
    """Which times are between two frames without a gap in the recording."""
    step = np.diff(when)
    after = np.clip(np.searchsorted(when, time), 1, when.size - 1)
    return np.asarray(step[after - 1] < HOLE * np.median(step))


def without_first_pose(
    error: Array, way: Array, weight: Array, first: tuple[float, float, float]
) -> Array:
    """Residuals after the best small shift and turn of the first pose, ridge-regularised.

    The twin starts from one camera frame, and its noise would turn the whole path. `error` is
    weighted and flat, `way` (k, 2 or 3) the recorded path from its first pose; `weight` has one
    column per compared coordinate; `first` [m, m, rad] are the first pose's standard errors.
    """
    zero, one = np.zeros(len(way)), np.ones(len(way))
    moves = [[one, zero, zero], [zero, one, zero], [-way[:, 1], way[:, 0], one]]
    columns = weight.shape[1]
    basis = np.stack([(np.stack(m[:columns], 1) * weight).ravel() for m in moves], axis=1)
    prior = np.diag(1 / np.square(first))
    best = np.linalg.solve(basis.T @ basis + prior, basis.T @ error)
    return np.asarray(error - basis @ best)


def _at(time: Array, when: Array, pose: Array) -> Array:
    """Poses between samples, by a cubic: a linear curve loses 1 % of a beat's yaw at 50 Hz."""
    return np.asarray(CubicSpline(when, np.nan_to_num(pose))(time))


def insensitive(
    residuals: Callable[[Array], Array], space: tuple[Parameter, ...], least: float = INSENSITIVE
) -> list[str]:
    """Paths of the free numbers that hardly change the result: one prior spread changes the
    residuals by less than `least` standard deviations (norm), at the prior's centre and on both
    sides of it."""
    reach = np.zeros(len(space))
    for shift in (-0.7, 0.0, 0.7):
        _, slope = sensitivity(residuals, np.full(len(space), shift))
        reach = np.maximum(reach, np.linalg.norm(slope, axis=0))
    return [p.path for p, norm in zip(space, reach, strict=True) if norm < least]
