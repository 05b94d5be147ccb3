"""Which readings are accepted: tests for spikes, jumps, a stuck shaft, a clock that jumped.

No device and no clock, as in `safety`: the loop keeps the readings, these functions test them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tailbeat.link.clock import DRIFT, SECOND
from tailbeat.link.datagrams import Frame

Echo = tuple[int, int, int]  # received at, offset, round trip [ns], as in `link.Clock`


GRACE = 0.16  # s: the servo's delay and the start of a tail at rest (chosen)
FOLLOWING = 0.5  # s within which the shaft must follow its setpoint
FEWEST = 10  # readings that judge a shaft, where so many are lost that half a second has fewer
READINGS = 50  # readings that are kept to judge it

Travel = tuple[float, float, float]  # time [s], setpoint and angle [rad] of one reading


@dataclass(frozen=True)
class Bounds:
    """Bounds on the fish's motion. Chosen with swims of the emulated fish: its yaw rate stays below
    2 rad/s and changes by at most 1.2 rad/s within two periods."""

    rate_most: float = 12.0  # rad/s
    rate_jump: float = 3.0  # rad/s from one reading to the next
    pose_room: float = (
        0.05  # m that a pose may differ from the last one, plus pose_speed per second
    )
    pose_speed: float = 1.0  # m/s
    yaw_room: float = 0.35  # rad
    yaw_speed: float = 8.0  # rad/s
    travel_asked: float = 0.3  # rad, travel of the setpoint from which the shaft must follow
    travel_seen: float = 0.02  # rad, travel of a shaft that follows
    clock_step: float = 0.005  # s, added to the allowed difference of two echoes


@dataclass(frozen=True)
class Gate:
    """State of the yaw rate test: the last rate accepted, the rate rejected just before, and how
    many were rejected in all."""

    believed: float | None = None
    refused: float | None = None
    count: int = 0


def gated(gate: Gate, rate: float, bounds: Bounds) -> tuple[Gate, bool]:
    """Test a yaw rate [rad/s]: accepted if it is near the last accepted one or near the one just
    rejected.

    A single spike is rejected; a real change is accepted one reading late. Returns the new state,
    and whether the rate is accepted.
    """
    if abs(rate) <= bounds.rate_most:
        known = [one for one in (gate.believed, gate.refused) if one is not None]
        if gate.believed is None or any(abs(rate - one) <= bounds.rate_jump for one in known):
            return Gate(rate, None, gate.count), True
    return Gate(gate.believed, rate, gate.count + 1), False


def pose_follows(last: Frame, new: Frame, bounds: Bounds) -> bool:
    """Whether the fish can have moved from the pose of frame `last` to that of `new`."""
    if last.fish is None or new.fish is None:
        return True
    dt = (new.captured - last.captured) / SECOND
    moved = math.dist(last.fish[:2], new.fish[:2])
    turned = abs(math.remainder(new.fish[2] - last.fish[2], 2 * math.pi))
    return (
        moved <= bounds.pose_room + bounds.pose_speed * dt
        and turned <= bounds.yaw_room + bounds.yaw_speed * dt
    )


def shaft_follows(readings: Sequence[Travel], bounds: Bounds) -> bool:
    """Whether the shaft follows its setpoints; `readings` since torque came on, oldest first.

    Judged are the last half second's, and at least `FEWEST`; until there are so many it is True.
    The setpoints of the last `GRACE` are left out: the shaft has not had time to follow them.
    """
    if len(readings) < FEWEST or readings[-1][0] - readings[0][0] < FOLLOWING:
        return True
    newest = readings[-1][0]
    recent = sum(when >= newest - FOLLOWING for when, *_ in readings)
    judged = list(readings)[-max(recent, FEWEST) :]
    settled = [asked for when, asked, _ in judged if when <= newest - GRACE]
    seen = [angle for *_, angle in judged]
    travel = max(settled) - min(settled) if settled else 0.0
    return travel < bounds.travel_asked or max(seen) - min(seen) >= bounds.travel_seen


def clock_step(echoes: Sequence[Echo], bounds: Bounds) -> int:
    """Jump of the sender's clock [ns]: the newest echo's offset minus the best earlier one; 0 if
    round trips and clock drift explain the difference."""
    if len(echoes) < 2:
        return 0
    when, offset, trip = echoes[-1]
    before, known, shortest = min(list(echoes)[:-1], key=lambda echo: echo[2])
    doubt = (trip + shortest) / 2 + DRIFT * abs(when - before) + bounds.clock_step * SECOND
    return offset - known if abs(offset - known) > doubt else 0
