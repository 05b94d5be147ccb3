"""The operator page's server, its own process: page, live socket, newest camera picture.

Everyone who can open it may watch and press STOP; every other order needs the token. A browser gets
the next snapshot when it has drawn the last: a slow one gets fewer, but never old ones. `client`
starts the server, and it ends with its owner.
"""

import asyncio
import contextlib
import hmac
import json
import math
import os
import secrets
import socket
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect

from tailbeat.operator.door import guarded, make_server, serve
from tailbeat.operator.messages import (
    NO_COMMAND,
    Message,
    accepted,
    is_number,
    messages,
    read_message,
    same_origin,
)

PAGES = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/map.js": ("map.js", "text/javascript"),
    "/changes.js": ("changes.js", "text/javascript"),
    "/distance.js": ("distance.js", "text/javascript"),
    "/replay.js": ("replay.js", "text/javascript"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self';"
    " img-src 'self' data:; connect-src 'self' ws: wss:; frame-ancestors 'none'; base-uri 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ORDERS = ("arm", "swim", "disarm")
PICTURE_AGE = 2.0  # s
PATIENCE = 1.0  # s for the owner to take a command
ANSWERS = 8  # that wait for a browser; one that reads none gets the newest


@dataclass(eq=False)
class Shown:
    """What the owner gave last; `count` numbers the snapshots, `fresh` is set by the next."""

    token: str
    room: tuple[float, float]
    owner: socket.socket
    snapshot: str = "null"
    picture: bytes = b""
    taken: float = -math.inf  # when the picture came [s]
    count: int = 0
    fresh: asyncio.Event = field(default_factory=asyncio.Event)

    def take(self) -> None:
        """Read all messages, of which only the newest counts, and say that we live."""
        with contextlib.suppress(OSError):
            while True:
                data = self.owner.recv(1 << 20)
                if data[:1] == b"{":
                    self.snapshot = data.decode()
                else:
                    self.picture, self.taken = data, time.monotonic()
        with contextlib.suppress(OSError):  # the owner is slow; it hears of us by the next
            self.owner.send(b'{"do": "alive"}')
        self.count += 1
        self.fresh.set()
        self.fresh = asyncio.Event()

    def filming(self) -> bool:
        """Whether there is a picture that is not old."""
        return time.monotonic() - self.taken < PICTURE_AGE

    async def hand_over(
        self, do: str, asker: str = "", at: tuple[float, float] | None = None
    ) -> str:
        """Give the owner a command: what to `do`, the browser that asked, and the place of a
        target. Returns "", or why not."""
        command = {"do": do, "asker": asker} if at is None else {"do": do, "at": at}
        for _ in range(round(PATIENCE / 0.01)):
            try:
                self.owner.send(json.dumps(command).encode())
                return ""
            except OSError:
                await asyncio.sleep(0.01)
        return "the station is too busy to take it; try again"


# ---- commands -----------------------------------------------------------------------------------


async def obey(shown: Shown, text: str, asker: str = "") -> str:
    """Handle one message of the browser `asker`; returns the answer, "" for none."""
    asked = read_message(text)
    if asked is None:
        return NO_COMMAND
    if asked.do == "stop":
        return await shown.hand_over("stop", asker)
    if not hmac.compare_digest(asked.token.encode(), shown.token.encode()):
        return "refused: wrong token; use the one printed at the start"
    if asked.do == "hello":
        return "token accepted"
    return await _trusted(shown, asked, asker)


async def _trusted(shown: Shown, asked: Message, asker: str) -> str:
    if asked.do in ORDERS or asked.do == "tag":
        return await shown.hand_over(asked.do, asker)
    if asked.do != "target":
        return NO_COMMAND
    if not is_place(asked.at):
        return "refused: a target is two numbers, in metres"
    (x, y), (length, width) = asked.at, shown.room
    if abs(x) > length / 2 or abs(y) > width / 2:
        return f"refused: the target is outside the pool of {length:g} by {width:g} m"
    return await shown.hand_over("target", at=(x, y))


def is_place(at: Any) -> bool:
    """Whether this is two numbers."""
    return isinstance(at, list) and len(at) == 2 and all(map(is_number, at))


# ---- browsers -----------------------------------------------------------------------------------


@dataclass(eq=False)
class Browser:
    """One open page: answers to send, and whether it has drawn the last snapshot. `name` is its
    own, by which it finds the outcomes of its orders in a snapshot."""

    socket: WebSocket
    said: deque[str] = field(default_factory=lambda: deque(maxlen=ANSWERS))
    drawn: asyncio.Event = field(default_factory=asyncio.Event)
    seen: int = 0
    name: str = field(default_factory=lambda: secrets.token_hex(4))

    async def tell(self, shown: Shown) -> None:
        """Send the newest snapshot whenever there is a newer one and the last is drawn."""
        while True:
            while shown.count == self.seen:
                await shown.fresh.wait()
            self.seen = shown.count
            said, self.said = list(self.said), deque(maxlen=ANSWERS)
            self.drawn.clear()
            about = {"you": self.name, "said": said, "camera": shown.filming()}
            await self.socket.send_text(f'{json.dumps(about)[:-1]}, "now": {shown.snapshot}}}')
            await self.drawn.wait()

    async def hear(self, shown: Shown) -> None:
        """Its messages: "drawn", or a command."""
        async for text in messages(self.socket):
            if text == "drawn":
                self.drawn.set()
            elif answer := await obey(shown, text, self.name):
                self.said.append(answer)


def make_app(shown: Shown, hosts: list[str]) -> FastAPI:
    """The server of what is shown, for browsers that call it by one of these names."""

    @asynccontextmanager
    async def listening(_: FastAPI) -> AsyncIterator[None]:
        asyncio.get_running_loop().add_reader(shown.owner, shown.take)
        await shown.hand_over("ready")
        yield

    app = guarded(FastAPI(lifespan=listening, openapi_url=None), hosts)
    add_pages(app)

    @app.get("/camera.jpg")
    async def camera() -> Response:
        if not shown.picture:
            return Response(status_code=404)
        return Response(shown.picture, media_type="image/jpeg", headers=HEADERS)

    @app.post("/stop")
    async def stop(request: Request) -> Response:
        if not same_origin(request.headers.get("origin"), request.headers.get("host")):
            return Response(status_code=403)
        return Response(await obey(shown, '{"do": "stop"}'))

    @app.websocket("/live")
    async def live(browser: WebSocket) -> None:
        if not await accepted(browser):
            return
        await attend(Browser(browser), shown)

    return app


async def attend(browser: Browser, shown: Shown) -> None:
    """Serve one browser until it disconnects."""
    telling = asyncio.create_task(browser.tell(shown))
    try:
        await browser.hear(shown)
    finally:
        telling.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await telling


def add_pages(app: FastAPI) -> None:
    """Let a server give the page's files."""
    for path, (name, kind) in PAGES.items():
        app.add_api_route(path, _page(Path(__file__).with_name(name), kind))


def _page(path: Path, kind: str) -> Callable[[], Awaitable[Response]]:
    async def page() -> Response:
        return Response(path.read_bytes(), media_type=kind, headers=HEADERS)

    return page


# ---- the process --------------------------------------------------------------------------------


async def _main(listening: socket.socket, owner: socket.socket) -> None:
    given = json.loads(sys.stdin.buffer.readline())
    shown = Shown(given["token"], tuple(given["room"]), owner)
    server = make_server(make_app(shown, given["hosts"]))

    def left() -> None:
        """End when the owner closes our standard input."""
        server.should_exit = not os.read(0, 1024)

    asyncio.get_running_loop().add_reader(0, left)
    await serve(server, listening)


if __name__ == "__main__":
    door, pipe = (socket.socket(fileno=int(number)) for number in sys.argv[1:3])
    pipe.setblocking(False)
    asyncio.run(_main(door, pipe))
