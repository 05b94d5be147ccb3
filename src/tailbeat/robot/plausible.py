"""Which readings are believed: a spike, a jump, a shaft that does not follow, a clock that stepped.

No device and no clock, as in `safety`; the loop keeps the readings, these functions judge them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tailbeat.link.clock import DRIFT, SECOND
from tailbeat.link.datagrams import Frame

Echo = tuple[int, int, int]  # when, offset, round trip [ns], as `link.Clock` keeps them


GRACE = 8  # periods, 0.16 s: the servo's delay, and a standing tail's start (chosen)


@dataclass(frozen=True)
class Bounds:
    """What a fish can do; chosen, against swims of the emulated one (its yaw rate stays below 2
    rad/s and changes by at most 1.2 rad/s within two periods)."""

    rate_most: float = 12.0  # rad/s
    rate_jump: float = 3.0  # rad/s from one reading to the next
    pose_room: float = 0.05  # m that a pose may be off the last one, and so much per second:
    pose_speed: float = 1.0  # m/s
    yaw_room: float = 0.35  # rad
    yaw_speed: float = 8.0  # rad/s
    travel_asked: float = 0.3  # rad that the setpoint travelled, while the shaft did not
    travel_seen: float = 0.02  # rad
    clock_step: float = 0.005  # s beyond what two echoes may differ by


@dataclass(frozen=True)
class Gate:
    """Of the yaw rate: the last one believed, the one refused just before, how many were refused
    in all."""

    believed: float | None = None
    refused: float | None = None
    count: int = 0


def gated(gate: Gate, rate: float, bounds: Bounds) -> tuple[Gate, bool]:
    """Whether a yaw rate [rad/s] is believed: near the last one, or the second in a row to say the
    same. A single spike is left out; a real change is accepted one reading late."""
    if abs(rate) <= bounds.rate_most:
        known = [one for one in (gate.believed, gate.refused) if one is not None]
        if gate.believed is None or any(abs(rate - one) <= bounds.rate_jump for one in known):
            return Gate(rate, None, gate.count), True
    return Gate(gate.believed, rate, gate.count + 1), False


def pose_follows(last: Frame, new: Frame, bounds: Bounds) -> bool:
    """Whether the fish can have come from one frame's pose to the other's."""
    if last.fish is None or new.fish is None:
        return True
    dt = (new.captured - last.captured) / SECOND
    moved = math.dist(last.fish[:2], new.fish[:2])
    turned = abs(math.remainder(new.fish[2] - last.fish[2], 2 * math.pi))
    return (
        moved <= bounds.pose_room + bounds.pose_speed * dt
        and turned <= bounds.yaw_room + bounds.yaw_speed * dt
    )


def shaft_follows(asked: Sequence[float], seen: Sequence[float], bounds: Bounds) -> bool:
    """Whether a shaft moves when it is asked to: setpoints and angles [rad] of the same periods.
    The last `GRACE` setpoints are left out: there was no time to follow them."""
    settled = asked[:-GRACE]
    if not settled or not seen:
        return True
    travel = max(settled) - min(settled)
    return travel < bounds.travel_asked or max(seen) - min(seen) >= bounds.travel_seen


def clock_step(echoes: Sequence[Echo], bounds: Bounds) -> int:
    """By how much [ns] the newest echo's offset lies off the best of those before, 0 where their
    round trips and the drift of two clocks explain it."""
    if len(echoes) < 2:
        return 0
    when, offset, trip = echoes[-1]
    before, known, shortest = min(list(echoes)[:-1], key=lambda echo: echo[2])
    doubt = (trip + shortest) / 2 + DRIFT * abs(when - before) + bounds.clock_step * SECOND
    return offset - known if abs(offset - known) > doubt else 0
