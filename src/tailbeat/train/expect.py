"""Derive what a policy's swims look like to its robot: tours in the twin, with all noise.

The robot compares its own signals with this (`control.consistency`). Nothing here is chosen by
hand but how far a bound lies beyond the most extreme value of the tours.
"""

from collections.abc import Callable
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize

from tailbeat.control import consistency, expected
from tailbeat.control.actions import PERIOD, Turning
from tailbeat.control.consistency import MODELLED, Signs, signs
from tailbeat.control.expected import Expected, Limits, ShaftModel, split
from tailbeat.control.policy import Policy, decide, load_policy, policy_path
from tailbeat.env.tours import Tours, settings, times, tours
from tailbeat.env.world import World, seeds_from
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.robot.fits import carried
from tailbeat.train.metadata import put

Array = NDArray[np.float64]
Progress = Callable[[float], None]
FISH, SECONDS, SEED = 48, 60.0, 77  # tours: about 300 targets
FEWER = 4, 12.0  # fish and seconds for a try-out, whose bounds mean little
FITTED = 8  # of the fish, to which the models are fitted
TAPS = 20  # motor angles that predict the yaw rate: 0.4 s
RIDGE = 1e-4  # of the mean power of an angle
LOOK = 10  # periods between two windows
FARTHER = 0.25  # of its distance from the median, by which a bound lies beyond the extreme
NEEDED = ("turning", "stroke", "recoil", "progress")  # a short tour has no drift
UNKNOWN = expected.BOUNDS["drifting"][1]  # rad/s, which no drift of a camera reaches
RARE = 0.001  # of the windows, whose gains do not set a bound
LEAST = 0.5  # of the median rms of a prediction, below which no gain is taken
_advance = njit(cache=True)(expected.advance)


def expect(
    policy: Policy,
    fish: Fish,
    progress: Progress = lambda done: None,
    size: tuple[int, float] = (FISH, SECONDS),
) -> Expected:
    """What to expect of a policy's swims, from tours of the `fish` that it was trained on: `size`
    is their number and length [s]. Raises BadInput for a policy whose tail hardly beats."""
    contract, (count, seconds) = policy.contract, size
    world = World(fish, settings(contract, seconds), seeds_from(SEED, count))
    swum = tours(lambda seen: decide(policy, seen), world, SEED, progress)
    shaft, recoil = fitted_shaft(fish, swum), fitted_recoil(swum)
    unbounded = Limits(*(0.0 for _ in fields(Limits)))
    draft = Expected(shaft, tuple(recoil.tolist()), unbounded, 0.0, 0.0, count * seconds)
    windows = rows(draft, swum)
    least = least_rms(draft, windows)
    draft = Expected(shaft, draft.recoil, unbounded, *least, draft.seconds)
    found = limits(statistics(draft, windows))
    return expected.bounded(Expected(shaft, draft.recoil, found, *least, draft.seconds))


def of_file(
    file: str,
    progress: Progress = lambda done: None,
    size: tuple[int, float] = (FISH, SECONDS),
) -> Expected:
    """Derive what to expect of a policy (a file or a shipped policy's name) and write it into its
    file. Raises BadInput for a motor that turns without end: its robot is not built."""
    policy = load_policy(file)
    if isinstance(policy.contract.actions, Turning):
        raise BadInput(f"{file}: its motor turns without end; signals are expected of others only.")
    found = expect(policy, carried(policy.contract), progress, size)
    write(policy_path(file), found)
    return found


def write(path: Path, found: Expected) -> None:
    """Write expectations into a policy's file, beside its contract, which does not change."""
    text = expected.as_text(found)
    expected.read(path, text)  # refuse before the file changes
    put(path, expected.KEY, text, path, overwrite=True)


# ---- the models ---------------------------------------------------------------------------------


def fitted_shaft(fish: Fish, swum: Tours) -> ShaftModel:
    """The fish's servo, with the load that explains the motor angles of the first tours."""
    servo, tail = fish.servos[fish.servo], fish.tail
    friction = servo.friction + tail.friction
    begin = np.log([servo.armature + 0.01, servo.damping + 0.01, (tail.k_eff or 0.0) + 0.1])

    def model(load: Any) -> ShaftModel:
        own = (servo.kp, servo.kv, servo.force_limit, servo.delay, friction)
        return ShaftModel(*map(float, (*own, *np.exp(load))))

    def cost(load: Any) -> float:
        errors = modelled(model(load), swum.sent[:FITTED]) - swum.angle[:FITTED]
        return float(np.square(errors).mean())

    return model(minimize(cost, begin, method="Nelder-Mead", options={"maxiter": 300}).x)


def modelled(model: ShaftModel, sent: Array) -> Array:
    """Angles (n, k) [rad] of the modelled shaft for setpoints (n, k) [rad], from straight."""
    whole, rest = split(model)
    before = np.concatenate([np.zeros((len(sent), whole + 1)), sent], axis=1)
    servo = (model.kp, model.kv, model.force_limit, model.friction)
    load = (model.inertia, model.damping, model.stiffness)
    return np.stack([_turned(one, sent.shape[1], rest, servo, load) for one in before])


@njit(cache=True)
def _turned(delayed, count, rest, servo, load):  # type: ignore[no-untyped-def]
    """One shaft's angles; period k gets the setpoints k and k + 1 of `delayed`."""
    angle, velocity, found = 0.0, 0.0, np.empty(count)
    for k in range(count):
        angle, velocity = _advance(angle, velocity, delayed[k], delayed[k + 1], rest, servo, load)
        found[k] = angle
    return found


def fitted_recoil(swum: Tours) -> Array:
    """Weights (taps,) [1/s], newest first, of the motor angles that give the yaw rate; a ridge
    regression over the first tours, in pieces without their means."""
    left, right, span = [], [], round(consistency.SPAN / PERIOD)
    for angle, rate in zip(swum.angle[:FITTED], swum.rate[:FITTED], strict=True):
        lagged = np.lib.stride_tricks.sliding_window_view(angle, TAPS)[:, ::-1]
        for first in range(0, len(lagged) - span, span):
            x, y = lagged[first : first + span], rate[TAPS - 1 + first :][:span]
            left.append(x - x.mean(axis=0))
            right.append(y - y.mean())
    a, b = np.concatenate(left), np.concatenate(right)
    square = a.T @ a
    ridge = RIDGE * np.trace(square) / TAPS * np.eye(TAPS)
    return np.asarray(np.linalg.solve(square + ridge, a.T @ b))


# ---- the bounds ---------------------------------------------------------------------------------


def rows(draft: Expected, swum: Tours) -> Array:
    """The windows' rows (n, k, 13), see `consistency.COLUMNS`, of whole tours. No
    current is known."""
    time = times(swum)
    mean = (swum.rate[:, 1:] + swum.rate[:, :-1]) / 2
    turned = np.concatenate([np.zeros((len(mean), 1)), np.cumsum(PERIOD * mean, axis=1)], axis=1)
    angles = modelled(draft.shaft, swum.sent)
    stamp = time - swum.frames[..., 5]
    columns = [np.broadcast_to(time, angles.shape), swum.angle, angles, swum.rate, turned, stamp]
    servo = np.stack([swum.sent, np.full_like(swum.sent, np.nan)], axis=-1)
    return np.concatenate([np.stack(columns, axis=-1), swum.frames[..., :5], servo], axis=-1)


def least_rms(draft: Expected, windows: Array) -> tuple[float, float]:
    """Least rms of the modelled angle [rad] and the predicted yaw rate [rad/s] for a gain: half of
    their medians."""
    span = round(consistency.SPAN / PERIOD)
    angles, rates = [], []
    for fish in windows:
        for last in range(span, len(fish), LOOK):
            part = fish[last - span : last]
            angles.append(np.std(consistency.straightened(part[:, MODELLED])))
            wanted = consistency.predicted(part[:, consistency.ANGLE], draft)
            rates.append(np.std(consistency.straightened(wanted)))
    return LEAST * float(np.median(angles)), LEAST * float(np.median(rates))


def statistics(draft: Expected, windows: Array) -> dict[str, Array]:
    """Every statistic of all windows, without what is not known."""
    span, most = (round(one / PERIOD) for one in (consistency.SPAN, consistency.LONGEST))
    found = [
        astuple(signs(fish[max(last - most, 0) : last], draft))
        for fish in windows
        for last in range(span + 1, fish.shape[0], LOOK)
    ]
    columns = np.array(found).T
    names = [one.name for one in fields(Signs)]
    return {name: one[np.isfinite(one)] for name, one in zip(names, columns, strict=True)}


def limits(found: dict[str, Array]) -> Limits:
    """Bounds a quarter beyond the extremes: of sizes and of progress by a factor, of gains seen
    from their medians. The one in a thousand windows with the most extreme gain is left out: a gain
    must be out of bounds three times in a row."""

    empty = [name for name in NEEDED if not found[name].size]
    if empty:
        raise BadInput(
            f"the policy's tours have no {', '.join(empty)} to expect: its tail hardly beats; train"
            f" it further."
        )

    def largest(name: str) -> float:
        sizes = np.abs(found[name])
        return float((1 + FARTHER) * sizes.max()) if sizes.size else UNKNOWN

    def beyond(name: str, share: float) -> float:
        middle, end = np.quantile(found[name], [0.5, share]).tolist()
        return float(middle + (1 + FARTHER) * (end - middle))

    return Limits(
        turning=largest("turning"),
        drifting=largest("drifting"),
        stroke_low=beyond("stroke", RARE),
        stroke_high=beyond("stroke", 1 - RARE),
        recoil_low=beyond("recoil", RARE),
        recoil_high=beyond("recoil", 1 - RARE),
        progress_low=float(found["progress"].min()) / (1 + FARTHER),
    )
