"""Checks of the shared key and of the link to the station: clocks, loss, age of the poses."""

import contextlib
import math
import socket
import statistics
import time
from pathlib import Path

from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Receiver
from tailbeat.robot.findings import Finding, finding
from tailbeat.robot.safety import SafetyLimits

LIMITS = SafetyLimits()
LISTEN = 2.0  # s that the check listens to the station


def check_key(path: Path | None) -> Finding:
    """Whether the shared key exists and only its owner can read it."""
    if path is None:
        return finding("key", "not given", bad=True)
    try:
        link.read_key(path)
    except BadInput as error:
        return finding("key", str(error), bad=True)
    return finding("key", str(path))


def listen_to(
    made: socket.socket, station: tuple[str, int], receiver: Receiver, seconds: float
) -> list[tuple[int, float]]:
    """Ask the station for its clock and take its poses for `seconds`.

    Returns sequence number and age [s] of each pose; the age is NaN while the clocks are not
    compared.
    """
    heard: list[tuple[int, float]] = []
    end, asked, questions = time.monotonic() + seconds, 0.0, 0
    while (now := time.monotonic()) < end:
        if now - asked > 0.1:
            asked, questions = now, questions + 1
            ask = link.ask_datagram(receiver.key, receiver.nonce, questions, time.monotonic_ns())
            with contextlib.suppress(OSError):
                made.sendto(ask, station)
        for data, _ in link.drain(made):
            before, now_ns = receiver.accepted, time.monotonic_ns()
            receiver.take(data, now_ns)
            if receiver.accepted > before:
                age = receiver.age(receiver.frames[0], now_ns)
                heard.append((receiver.last, math.nan if age is None else age))
        time.sleep(0.002)
    return heard


def check_link(
    made: socket.socket,
    station: tuple[str, int],
    receiver: Receiver,
    seconds: float = LISTEN,
    limits: SafetyLimits = LIMITS,
) -> list[Finding]:
    """Check clock offset, loss, age of the poses, and whether fish and target are seen."""
    heard = listen_to(made, station, receiver, seconds)
    offset = receiver.clock.offset(time.monotonic_ns())
    if offset is None:
        strange = f"; rejected: {dict(receiver.rejected)}" if receiver.rejected else ""
        where = f"{station[0]}:{station[1]}"
        return [finding("station answers", f"nothing from {where}{strange}", bad=True)]
    ahead, doubt = offset[0] / link.SECOND, offset[1] / link.SECOND
    said = f"ahead by {ahead:.3f} s, known to {1e3 * doubt:.1f} ms"
    known = finding("clocks compared", said, bad=doubt >= limits.clock_doubt, warn=doubt > 0.01)
    answers = finding("station answers", "yes")
    if not heard:
        return [answers, known, finding("poses", f"none in {seconds:g} s", bad=True)]
    return [answers, known, *_poses(heard, receiver.frames[0], seconds, limits)]


def _poses(
    heard: list[tuple[int, float]], frame: link.Frame, seconds: float, limits: SafetyLimits
) -> list[Finding]:
    ages = [age for _, age in heard if not math.isnan(age)]
    rate, age = len(heard) / seconds, statistics.median(ages) if ages else math.nan
    lost = 1 - len(heard) / (heard[-1][0] - heard[0][0] + 1)
    old, fish, target = not age < limits.pose_hold, frame.fish, frame.target
    return [
        finding("poses per second", f"{rate:.0f}", bad=rate < 15, warn=rate < 40),
        finding("datagrams lost", f"{100 * lost:.0f} %", bad=lost > 0.5, warn=lost > 0.1),
        finding("pose age", f"{1e3 * age:.0f} ms", bad=old, warn=age > 0.1),
        finding("fish seen", "yes" if fish else "no", bad=fish is None),
        finding("target seen", "yes" if target else "no", warn=target is None),
    ]
