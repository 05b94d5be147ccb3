"""The station's end of the operator page: starts its server process, sends snapshots, takes orders.

Both directions use a pair of datagram sockets that never wait. If the server is slow, snapshots are
dropped; if the station is slow, the server says so. The server answers every snapshot. If it does
not answer for 0.4 s, the operator is told that it hangs. One that ended, or that does not answer
for two seconds, is started again.
"""

import contextlib
import json
import math
import secrets
import select
import signal
import socket
import subprocess
import time
from collections import deque
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Any

from tailbeat.files import BadInput, need, plain
from tailbeat.fish.description import Fish
from tailbeat.link.addresses import address
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Order
from tailbeat.link.places import POOL
from tailbeat.link.sender import Sender
from tailbeat.link.status import Status
from tailbeat.operator.snapshot import Change, snapshot
from tailbeat.operator.target_motion import Trace
from tailbeat.processes import end, start

EVERY = 0.05  # s between two snapshots
LARGEST = 180_000  # bytes, largest datagram and picture
AGAIN = 5.0  # s between two starts of the server
READY = 60.0  # s that it may take to start
SILENT = 0.4  # s without an answer to a snapshot: the server hangs; this is reported
HUNG = 2.0  # s: it is replaced; a new one takes seconds to start
FAREWELL = 3.0  # s that it may take to end
COMMANDS = 20  # most commands read at once
HANGS = "the operator page's server hangs; Ctrl-C here stops the fish"
ANSWERS = "the operator page's server answers again"
ALIVE = ("ready", "alive")  # messages of the server itself
CHANGES = 8  # of the state that the page lists


@dataclass(eq=False)
class OperatorClient:
    """An open operator page; see `open_client`. `url` contains the token."""

    listening: socket.socket
    room: tuple[float, float]
    token: str
    url: str
    ours: socket.socket
    theirs: socket.socket
    process: "subprocess.Popen[bytes] | None" = None
    picture: bytes = b""  # the last that was shown
    due: float = 0.0
    again: float = 0.0
    ready: bool = False  # whether the present server has started
    hangs: bool = False  # whether it was reported to hang
    asked: float = math.inf  # when the first snapshot was sent that is not answered [s]
    changes: deque[Change] = field(default_factory=lambda: deque(maxlen=CHANGES))
    trace: Trace = field(default_factory=Trace)  # of the target

    def note(self, status: Status | None, at: float) -> None:
        """Keep a state or a reason that differs from the last; `at` is the time of day [s since
        1970]."""
        if status is None:
            return
        last = self.changes[-1] if self.changes else None
        if last is None or (last.state, last.reason) != (status.state.value, status.text):
            self.changes.append(Change(at, status.state.value, status.text))

    def show(self, snapshot: dict[str, Any], picture: bytes) -> None:
        """Send a snapshot, and a JPEG if it is new; both are dropped if the server is slow."""
        words = json.dumps(plain(snapshot), allow_nan=False).encode()
        image = b"" if picture is self.picture else picture
        self.picture = picture
        self.asked = min(self.asked, time.monotonic())
        for datagram in (words, image):
            if datagram and len(datagram) <= LARGEST:
                with contextlib.suppress(OSError):
                    self.ours.send(datagram)

    def commands(self, patience: float = 0.0) -> list[dict[str, Any]]:
        """Orders of operators with the token since the last call, oldest first; waits up to
        `patience` [s] for a message of the server."""
        found: list[dict[str, Any]] = []
        if patience:
            select.select([self.ours], [], [], patience)
        with contextlib.suppress(OSError):
            for _ in range(COMMANDS):
                found.append(json.loads(self.ours.recv(4096)))
        if found:  # the server is alive
            self.asked = math.inf
        self.ready = self.ready or any(one["do"] == "ready" for one in found)
        return [one for one in found if one["do"] not in ALIVE]

    def close(self) -> None:
        """End the server, also if it hangs."""
        if self.process is not None:
            self._hang_up()  # a server that does not hang ends by this too
            end(self.process, signal.SIGTERM, FAREWELL)
        for one in (self.listening, self.ours, self.theirs):
            one.close()

    def _keep(self, now: float) -> str:
        """Start the server if it does not run, and replace one that hangs; returns what happened,
        or ""."""
        if self.process is not None and self.process.poll() is None:
            silence = time.monotonic() - self.asked
            if silence < (HUNG if self.ready else READY):
                return self._heard_of(silence)
            self.process.kill()
            self.process.wait()
            news = "the operator page's server hung; it is started again"
        else:
            news = "the operator page's server ended; it is started again" if self.ready else ""
        self.ready = self.hangs = False
        if now >= self.again:
            self.again = now + AGAIN
            self._start()
        return news

    def _heard_of(self, silence: float) -> str:
        """What there is to say of a server that has not answered for a time [s]; "" for nothing
        new."""
        hangs = self.ready and silence > SILENT
        if hangs == self.hangs:
            return ""
        self.hangs = hangs
        return HANGS if hangs else ANSWERS

    def _hang_up(self) -> None:
        """Close the server's standard input."""
        if self.process is not None and self.process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.process.stdin.close()

    def _start(self) -> None:
        """Start the server. What is needed goes through a pipe: a command line would show it."""
        self._hang_up()
        handles = self.listening.fileno(), self.theirs.fileno()
        self.process = start(
            ["-m", "tailbeat.operator.server", *map(str, handles)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=handles,
        )
        self.ready, self.asked = False, math.inf
        assert self.process.stdin is not None
        hosts = allowed_hosts(self.listening)
        words = {"token": self.token, "room": self.room, "hosts": hosts}
        with contextlib.suppress(BrokenPipeError):  # it ended at once; `_keep` starts another
            self.process.stdin.write(json.dumps(words).encode() + b"\n")
            self.process.stdin.flush()


def open_page(page: str, pool: tuple[float, float] = POOL) -> OperatorClient | None:
    """The operator's page at `host:port` for a pool of this length and width [m], or None where
    the address is empty."""
    if not page:
        return None
    need("the operator page", "fastapi", "uvicorn", "websockets")
    return open_client(address(page, "--page"), pool)


def open_client(at: tuple[str, int], room: tuple[float, float]) -> OperatorClient:
    """Open the operator page at host and port (0: any free one) for a pool of this size [m]. Raises
    BadInput where the address cannot be had. Returns when the page can be seen."""
    listening = listen(at)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    for one in (ours, theirs):
        one.setblocking(False)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * LARGEST)
    token = secrets.token_urlsafe(12)
    host, port = listening.getsockname()
    client = OperatorClient(
        listening, room, token, f"http://{host}:{port}/#token={token}", ours, theirs
    )
    client._keep(time.monotonic())
    client.commands(READY)
    if not client.ready:
        client.close()
        raise BadInput("the operator page's server did not start; see its message above.")
    return client


def listen(at: tuple[str, int]) -> socket.socket:
    """A socket that listens for browsers at host and port (0: any free one). Raises BadInput where
    the address cannot be had."""
    if at[0] in ("", "0.0.0.0"):
        raise BadInput(f"--page {at[0]!r}: this means all networks; give the address of one.")
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(at)
    except OSError as error:
        listening.close()
        raise BadInput(
            f"--page {at[0]}:{at[1]}: {error.strerror}; choose another address or port."
        ) from None
    listening.listen()
    return listening


def allowed_hosts(listening: socket.socket) -> list[str]:
    """The names by which browsers may call a server: the address that it listens on, and
    "localhost" where only this machine reaches it, else this machine's name."""
    host, name = listening.getsockname()[0], socket.gethostname().lower()
    if is_local(host):
        return [host, "localhost"]
    return [host, name, f"{name.removesuffix('.local')}.local"]


def is_local(host: str) -> bool:
    """Whether only this machine can reach an address."""
    return ip_address(host).is_loopback


def announce(client: OperatorClient) -> list[str]:
    """Messages for the operator: the page's address, and whether others can open it."""
    lines = [f"operator page: {client.url}"]
    if not is_local(client.listening.getsockname()[0]):
        lines.append(
            "warning: the operator page is open to this network, unencrypted. Everyone on it can"
            " watch, press STOP and read the token. Use a network of your own."
        )
    return lines


def turn(
    client: OperatorClient,
    sender: Sender,
    fish: Fish,
    now: float,
    note: str = "",
    picture: bytes = b"",
) -> str:
    """Follow the operators' orders, and send a snapshot if one is due at `now` [s]. `note` is about
    the camera, `picture` is its newest JPEG. Returns what happened to the server, "" for nothing.
    """
    for command in client.commands():
        _attend(sender, command, now)
    client.note(sender.status, time.time())
    if sender.frames:
        client.trace.add(sender.frames[-1])
    if now < client.due:
        return ""
    client.due = now + EVERY
    news = client._keep(now)
    seen = snapshot(sender, fish, client.room, now, note)
    moves = client.trace.velocity(sender.clock() / SECOND)
    client.show({**seen, "velocity": moves, "changes": tuple(client.changes)}, picture)
    return news


def _attend(sender: Sender, command: dict[str, Any], now: float) -> None:
    match command["do"]:
        case "target":
            x, y = command["at"]
            sender.target = (x, y)
        case "tag":
            sender.target = None
        case wanted:
            sender.order(Order[wanted.upper()], now, command["asker"])
