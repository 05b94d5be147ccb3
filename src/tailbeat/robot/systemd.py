"""Messages to systemd: ready, the state, and that the loop still runs (sd_notify(3)).

Each is a datagram to the socket that the service manager names; without a socket nothing is sent.
The module also writes the unit that runs the loop as a service.
"""

import os
import socket
import sys
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

from tailbeat.files import BadInput, new_file

EVERY = 0.25  # s between two messages; WatchdogSec is 2


def _datagrams() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)


@dataclass(eq=False)
class Notifier:
    """Sends the messages; see `from_environment`."""

    address: str
    line: socket.socket = field(default_factory=_datagrams)
    due: float = 0.0
    said: str = ""

    def beat(self, now: float, status: str) -> None:
        """Report that the loop ran at `now` [s], monotonic, and its status.

        Sends four times a second, and at once when the status changes. The first message reports
        that the service is ready.
        """
        if not self.address or (now < self.due and status == self.said):
            return
        first = "READY=1\n" if not self.said else ""
        self.due, self.said = now + EVERY, status
        self._send(f"{first}WATCHDOG=1\nSTATUS={status}")

    def end(self) -> None:
        """Report that the service stops intentionally."""
        if self.address:
            self._send("STOPPING=1")
        self.line.close()

    def _send(self, text: str) -> None:
        try:
            self.line.sendto(text.encode(), socket.MSG_DONTWAIT, self.address)
        except OSError:
            pass  # a manager that does not answer must not delay the loop


def from_environment() -> Notifier:
    """The notifier for NOTIFY_SOCKET, a path or an abstract name; it sends nothing if this is not
    set."""
    name = os.environ.get("NOTIFY_SOCKET", "")
    return Notifier("\0" + name[1:] if name.startswith("@") else name)


def write_unit(out: Path, user: str, servo: str, words: list[str]) -> None:
    """Write a unit for `tailbeat drive` with these words. Raises BadInput."""
    text = unit(sys.executable, user, servo, words)
    with new_file(out) as beside:
        beside.write_text(text, encoding="utf-8")


def unit(python: str, user: str, servo: str, words: list[str]) -> str:
    """The text of a unit that runs `tailbeat drive` with these words, disarmed until ordered.
    Raises BadInput where a word cannot be part of a unit."""
    for word in (python, user, servo, *words):
        if not word or "\n" in word or (word in (user, servo) and " " in word):
            raise BadInput(f"{word!r}: not allowed in a unit; give one word without line breaks.")
    template = (resources.files("tailbeat.robot") / "fish.service").read_text("utf-8")
    line = " ".join(_quoted(word) for word in [python, "-m", "tailbeat", "drive", *words])
    last = " ".join(_quoted(word) for word in [python, "-m", "tailbeat.robot.watchdog", servo])
    return template.format(user=user, drive=line, torque_off=f"{last} 1 1000000 now")


def _quoted(word: str) -> str:
    """Quote for systemd.syntax(7) and systemd.service(5): `%` and `$` doubled, quotes escaped."""
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if text != word or " " in word else word
