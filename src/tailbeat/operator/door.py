"""Who may connect to a page's server, for how long, and how many at once.

uvicorn has no time limit for a request's header, and no limit per address. So each connection is a
`Visit` between the socket and uvicorn's protocol. A request and its answer must be over in five
seconds, and a connection serves one request; a WebSocket may stay. Where an address, or all of them
together, have too many connections, the one that is silent longest is closed. So a new STOP always
gets in, and another address cannot use up the places of the operator's.
"""

import asyncio
import logging
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

import uvicorn
from fastapi import FastAPI
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

MOST, EACH = 256, 64  # connections at once, and of one address
REQUESTS = 4  # a quarter of the places is for requests, the rest for pages that are open
HURRY = 5.0  # s for a request and its answer
BATCH = 128  # connections accepted at once: together with MOST below 1024 open files
QUEUE = 4096  # connections that the kernel keeps until they are accepted
LONGEST = 2000  # characters of a message
# Beginnings of what uvicorn reports of a client's faults: anybody could fill the terminal with it.
ODD_CLIENT = ("Invalid ", "Unsupported upgrade")


@dataclass(eq=False)
class Door:
    """The visits that are open, of each address together."""

    visits: list["Visit"] = field(default_factory=list)

    def enter(self, new: "Visit") -> None:
        """Take in a connection; close the one that is silent longest where there are too many."""
        self.visits.append(new)
        same = [one for one in self.visits if one.address == new.address]
        for crowd, most in ((same, EACH), (self.visits, MOST)):
            if len(crowd) > most:
                longest_silent(crowd).leave()


def longest_silent(crowd: list["Visit"]) -> "Visit":
    """The visit to close. Requests have a quarter of the places, so that neither kind can use up
    those of the other."""
    requests = [one for one in crowd if not one.stays]
    stayers = [one for one in crowd if one.stays]
    found = requests if len(requests) > len(crowd) // REQUESTS else stayers
    return min(found, key=lambda one: one.heard)


@dataclass(eq=False)
class Visit(asyncio.Protocol):
    """One connection: passes everything on to uvicorn's protocol, and counts its time.

    `inner` is None until something comes: a crowd that says nothing costs little. `state` has the
    connections that uvicorn closes at its end.
    """

    door: Door
    state: ServerState
    make: Callable[[], Any]
    inner: Any = None
    transport: asyncio.Transport = None  # type: ignore[assignment]
    address: str = ""
    heard: float = 0.0  # when its last word came [s of the event loop]
    stays: bool = False  # whether it became a WebSocket
    limit: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin: the time for the request runs."""
        self.transport = cast(asyncio.Transport, transport)
        loop, peer = asyncio.get_running_loop(), transport.get_extra_info("peername")
        self.address, self.heard = peer[0] if peer else "", loop.time()
        self.limit = loop.call_later(HURRY, self.leave)
        self.state.connections.add(cast(Any, self))
        self.door.enter(self)

    def shutdown(self) -> None:
        """Close a connection that said nothing; uvicorn closes the others itself, at its end."""
        if self.inner is None:
            self.leave()

    def stay(self, inner: asyncio.BaseProtocol) -> None:
        """Go on as a WebSocket, which has no limit of time."""
        self.inner, self.stays = inner, True
        self._unlimited()

    def leave(self) -> None:
        """Close at once, also where the other side does not read."""
        self._forget()
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Pass on what came."""
        self.heard = asyncio.get_running_loop().time()
        if self.inner is None:
            self.inner = self.make()
            self.inner.connection_made(Handle(self))
        self.inner.data_received(data)

    def eof_received(self) -> bool | None:
        """Pass on that the other side sends no more."""
        return self.inner.eof_received() if self.inner is not None else None

    def pause_writing(self) -> None:
        """Pass on that the other side reads slowly."""
        self.inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that it has read."""
        self.inner.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass on the end."""
        self._forget()
        if self.inner is not None:
            self.inner.connection_lost(exc)

    def _unlimited(self) -> None:
        if self.limit is not None:
            self.limit.cancel()
            self.limit = None

    def _forget(self) -> None:
        self._unlimited()
        self.state.connections.discard(cast(Any, self))
        if self in self.door.visits:
            self.door.visits.remove(self)


@dataclass(frozen=True, eq=False)
class Handle:
    """A visit's transport as uvicorn sees it: a change of protocol changes the visit's inner."""

    visit: Visit

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """uvicorn calls this when a request becomes a WebSocket."""
        self.visit.stay(protocol)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.visit.transport, name)


# ---- the server ---------------------------------------------------------------------------------


def guarded(app: FastAPI, hosts: list[str]) -> FastAPI:
    """Let an app answer under these names alone, and each connection one request alone.

    Another site may point its own name to this machine, so that its page counts as ours (DNS
    rebinding); it is refused by that name.
    """
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False)
    app.add_middleware(OneRequest)
    return app


@dataclass(frozen=True, eq=False)
class OneRequest:
    """Middleware: every answer closes its connection."""

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, and say that the connection ends."""

        async def last(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), (b"connection", b"close")]
            await send(message)

        await self.app(scope, receive, last if scope["type"] == "http" else send)


def make_server(app: FastAPI) -> uvicorn.Server:
    """A server of an app, for `serve`."""
    door = Door()

    def visit(_loop: Any = None, **words: Any) -> Visit:
        return Visit(door, words["server_state"], partial(H11Protocol, _loop=_loop, **words))

    config = uvicorn.Config(
        app,
        http=cast(Any, visit),
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
        ws_max_size=LONGEST,
        backlog=BATCH,
    )
    logging.getLogger("uvicorn.error").addFilter(
        lambda record: not record.getMessage().startswith(ODD_CLIENT)
    )
    return uvicorn.Server(config)


async def serve(server: uvicorn.Server, listening: socket.socket) -> None:
    """Serve browsers at a listening socket until the server is told to end."""
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.01)
    if not serving.done() and not server.should_exit:  # else the socket may be closed
        listening.listen(QUEUE)  # uvicorn listens with the size of a batch
    await serving
