"""What the page shows, as one JSON-ready dictionary: everything that the station knows of the fish.

Lengths in metres, angles in radians, times in seconds; the page converts units.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.outline import guessed_shape, outline
from tailbeat.fish.store import hardware_of
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Frame
from tailbeat.link.sender import Sender
from tailbeat.link.status import Status
from tailbeat.robot.safety import limits_for

Array = NDArray[np.float64]
OLD = 1.0  # s: an older frame is not shown as the present
FIN = 0.005  # m, half of a fin's thickness in the drawing
HEAD = ((0.1, 0.7), (0.35, 1.0), (0.7, 0.95))  # drawing: position from nose to hinge, width


@dataclass(frozen=True)
class Change:
    """A state of the fish and its reason, and when it began [s]: the time of day for a live fish,
    since the first row for a log."""

    at: float
    state: str
    reason: str


def snapshot(
    sender: Sender, fish: Fish, room: tuple[float, float], now: float, note: str = ""
) -> dict[str, Any]:
    """Everything at `now` [s]; None where nothing is known. `note` is about the camera."""
    status, frame = sender.status, sender.seen
    return {
        "room": room,
        "fish": _fish(sender, fish, frame) if frame else None,
        "target": _target(sender),
        "away": _away(sender),
        "operator": sender.target is not None,
        "outcomes": [asdict(one) for one in sender.outcomes],
        "note": note,
        "status": _status(status, now - sender.heard) if status else None,
        "loss_back": sender.loss.share(),
        "limits": asdict(limits_for(hardware_of(fish))),
    }


def _fish(sender: Sender, fish: Fish, frame: Frame) -> dict[str, Any]:
    assert frame.fish is not None
    motor = sender.status.numbers.angle if sender.status else 0.0
    return {
        "pose": frame.fish,
        "age": (sender.clock() - frame.captured) / SECOND,
        "body": body(fish, frame.fish, motor if np.isfinite(motor) else 0.0),
    }


def _target(sender: Sender) -> tuple[float, float] | None:
    """The target that is sent; one that the camera sees only while it sees it."""
    newest = _newest(sender)
    return sender.target or (newest.target if newest else None)


def _newest(sender: Sender) -> Frame | None:
    """The newest frame, if it is new: without a camera the last one stays."""
    newest = sender.frames[-1] if sender.frames else None
    old = newest is None or sender.clock() - newest.captured > OLD * SECOND
    return None if old else newest


def _away(sender: Sender) -> float | None:
    """Distance of the fish's tag from the target in the newest frame [m]; None if one is not in it,
    or if it is old."""
    newest = _newest(sender)
    if newest is None or newest.fish is None or newest.target is None:
        return None
    return math.dist(newest.fish[:2], newest.target)


def _status(status: Status, age: float) -> dict[str, Any]:
    numbers = asdict(status.numbers)
    target = numbers.pop("target_x"), numbers.pop("target_y")
    return {
        "state": status.state.value,
        "reason": status.text,
        "cause": status.reason.name.lower(),
        "age": age,
        "missed": status.missed,
        "rejects": status.rejects,
        "offset": status.offset,
        "target": target if np.isfinite(target).all() else None,
        **numbers,
    }


def body(fish: Fish, pose: tuple[float, float, float], motor: float) -> list[list[float]]:
    """The fish from above, nose to fin: x, y and half the width [m] at each point.

    Only the tag's pose and the motor angle are known, so all hinges get the same bend: a picture,
    not an estimate.
    """
    links = fish.tail.links
    line = outline(fish, guessed_shape(fish, pose, motor))
    head = max(part.size[1] for part in fish.head.parts) / 2
    tail = [max(part.size[1] for part in one.parts) / 2 for one in links]
    along = np.array([share for share, _ in HEAD])[:, None]
    shell = line[0] + along * (line[1] - line[0])
    widths = [FIN, *(wide * head for _, wide in HEAD), *tail, FIN]
    return np.column_stack([np.concatenate([line[:1], shell, line[1:]]), widths]).tolist()
