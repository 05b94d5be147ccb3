"""The robot's status: one signed datagram ten times a second, to the station.

It names the sender's run that the robot follows, so that the station rejects statuses recorded
before its own start. It also carries the number of the newest order taken, so that the station can
repeat a lost order.
"""

import math
import struct
from dataclasses import dataclass, fields
from enum import Enum

from tailbeat.link.datagrams import HEAD, MAC_BYTES, is_signed, sign
from tailbeat.link.reasons import REASONS, Reason

STATUS = b"tbR3"
TEXT_BYTES = 160  # of the reason's text, UTF-8; a longer text is cut


class State(Enum):
    """DISARMED: no torque. ARMED: torque on, tail held. TEST: the sign test before the first swim.
    RUN: the policy swims. HOLD: tail moves to straight and waits. STOP: no torque, until the robot
    is disarmed."""

    DISARMED = "disarmed"
    ARMED = "armed"
    TEST = "test"
    RUN = "run"
    HOLD = "hold"
    STOP = "stop"


STATES = tuple(State)
# state, reason, missed, rejects, order, offset, the reason's text
FIRST = struct.Struct(f"<BBHIQd{TEXT_BYTES}s")


@dataclass(frozen=True)
class Numbers:
    """The numbers of a status, in SI units; NaN where a number is not known.

    Age of the newest pose, and the ages that lead to HOLD and STOP [s]. Motor angle and setpoint
    sent [rad]. Servo temperature [deg C], voltage [V], current [A]. Latest start and longest
    duration of a period since the last status [s]. Fraction of the tail's power below the band's
    upper edge. Largest error of the clock offset [s]. Fraction of poses lost. The target that the
    fish swims to [m].
    """

    pose_age: float = math.nan
    pose_hold: float = math.nan
    pose_stop: float = math.nan
    angle: float = math.nan
    setpoint: float = math.nan
    temperature: float = math.nan
    voltage: float = math.nan
    current: float = math.nan
    late: float = math.nan
    busy: float = math.nan
    band_share: float = math.nan
    clock_doubt: float = math.nan
    loss: float = math.nan
    target_x: float = math.nan
    target_y: float = math.nan


NUMBERS = struct.Struct(f"<{len(fields(Numbers))}f")
LENGTH = HEAD.size + FIRST.size + NUMBERS.size + MAC_BYTES


@dataclass(frozen=True)
class Status:
    """A status of the robot.

    State, reason and its text; periods `missed` within a second; datagrams rejected since the
    start; number of the newest `order` taken; sender's clock minus the fish's, `offset` [s]; and
    the numbers.
    """

    state: State
    reason: Reason
    text: str
    missed: int
    rejects: int
    order: int
    offset: float
    numbers: Numbers


def status_datagram(key: bytes, run: int, nonce: int, sequence: int, status: Status) -> bytes:
    """A signed status of the fish's start `nonce` for the sender's run. A long text is cut."""
    text = status.text.encode()[:TEXT_BYTES].decode(errors="ignore").encode()
    first = FIRST.pack(
        STATES.index(status.state),
        REASONS.index(status.reason),
        min(status.missed, 0xFFFF),
        min(status.rejects, 0xFFFF_FFFF),
        status.order,
        status.offset,
        text,
    )
    numbers = NUMBERS.pack(*(getattr(status.numbers, one.name) for one in fields(Numbers)))
    return sign(key, HEAD.pack(STATUS, run, nonce, sequence) + first + numbers)


def read_status(key: bytes, data: bytes) -> tuple[int, int, int, Status] | None:
    """The sender's run, the fish's nonce, the sequence number and the status; None if the datagram
    is not a signed status of this version."""
    if not is_signed(key, data, STATUS, LENGTH):
        return None
    _, run, nonce, sequence = HEAD.unpack_from(data)
    state, why, missed, rejects, order, offset, text = FIRST.unpack_from(data, HEAD.size)
    if state >= len(STATES) or why >= len(REASONS):
        return None  # of another version
    numbers = Numbers(*NUMBERS.unpack_from(data, HEAD.size + FIRST.size))
    words = text.rstrip(b"\0").decode(errors="replace")
    status = Status(STATES[state], REASONS[why], words, missed, rejects, order, offset, numbers)
    return run, nonce, sequence, status
