"""Remove glitches from recordings of tails and swims: the limits of each column.

A row is left out if its angle, torque or pose is a glitch. A marker that is a glitch becomes unseen
(NaN) in that frame. Nothing is replaced.
"""

from dataclasses import replace

import numpy as np

from tailbeat.identify.glitches import (
    HEADING,
    MARKER,
    PLACE,
    SHAFT,
    SLOW_PULL,
    TAIL,
    Glitch,
    SignalLimits,
    find,
)
from tailbeat.recording import Array, Recording, is_marker, rows

BANDWIDTH = 12.0  # Hz above which a driven tail's torque has no power, chosen
NOISY = 0.1  # fraction of the torque's span by which a sample may be off, chosen
SWIM = {"x_m": PLACE, "y_m": PLACE, "yaw_rad": HEADING, "motor_angle_rad": SHAFT}

Cleaned = tuple[Recording, tuple[Glitch, ...]]


def clean_tail(recording: Recording, shaft: SignalLimits = TAIL) -> Cleaned:
    """A tail's recording without the rows in which angle or torque is a glitch, and what was left
    out. `shaft` are the limits of the angle."""
    limits = {"angle_rad": shaft}
    if "torque_nm" in recording.columns:
        limits["torque_nm"] = of_bandwidth(recording.columns["torque_nm"])
    return _without(recording, {k: v for k, v in limits.items() if k in recording.columns})


def clean_pull(recording: Recording) -> Cleaned:
    """`clean_tail` with the limits of a slow pull."""
    return clean_tail(recording, SLOW_PULL)


def clean_swim(recording: Recording) -> Cleaned:
    """A swim without the frames in which pose or motor angle is a glitch, and what was left out.
    Glitches of markers become NaN."""
    limits = {name: limit for name, limit in SWIM.items() if name in recording.columns}
    marked = {name: MARKER for name in recording.columns if is_marker(name)}
    good, found = find(recording, {**limits, **marked})
    columns = dict(recording.columns)
    for name in marked:
        columns[name] = np.where(good[name], columns[name], np.nan)
    kept = np.all([good[name] for name in limits], axis=0) if limits else slice(None)
    return rows(replace(recording, columns=columns), kept), tuple(found)


def _without(recording: Recording, limits: dict[str, SignalLimits]) -> Cleaned:
    good, found = find(recording, limits)
    kept = np.all([np.ones(recording.time.size, dtype=bool), *good.values()], axis=0)
    return (recording if kept.all() else rows(recording, kept)), tuple(found)


def of_bandwidth(signal: Array) -> SignalLimits:
    """Limits of a `signal` (n,) that has no power above `BANDWIDTH`, from the span of most of its
    samples (Bernstein's bounds on slope and curvature)."""
    span = float(np.ptp(np.quantile(signal, [0.02, 0.98])))
    omega = 2 * np.pi * BANDWIDTH
    return SignalLimits(omega * span / 2, omega**2 * span / 2, NOISY * span + 1e-12)
