"""Serve the replay of a run on the operator page. No fish, camera or link is behind it.

The page speaks with it as with a station's server, in questions and answers: it asks for a moment
and gets its snapshot. Every browser plays at its own pace. An order is refused with the reason.
"""

import asyncio
import contextlib
import json
import socket
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response, WebSocket, WebSocketDisconnect

from tailbeat.files import plain
from tailbeat.fish.description import Fish
from tailbeat.link.addresses import address
from tailbeat.link.places import POOL
from tailbeat.operator.client import allowed_hosts, is_local, listen
from tailbeat.operator.door import guarded, make_server, serve
from tailbeat.operator.messages import NO_COMMAND, accepted, is_number, messages, read_message
from tailbeat.operator.replay import Run, read_run, snapshot
from tailbeat.operator.server import add_pages
from tailbeat.processes import told_to_end
from tailbeat.robot.logged import fish_in

NO_ORDERS = "refused: this is the replay of a log; no fish is connected"


@dataclass(frozen=True, eq=False)
class Shown:
    """What is replayed: a run, the fish to draw, length and width of the pool [m]."""

    run: Run
    fish: Fish
    room: tuple[float, float]


def _about(run: Run) -> dict[str, Any]:
    """The first message to the page."""
    changes = [asdict(one) for one in run.changes()]
    return {"name": run.name, "seconds": run.seconds, "whole": run.whole, "changes": changes}


def _answer(shown: Shown, text: str) -> dict[str, Any]:
    """Answer one message of a browser: {"do": "at", "at": seconds}, or an order."""
    asked = read_message(text)
    if asked is None:
        return {"said": [NO_COMMAND]}
    if asked.do != "at":
        return {"said": [NO_ORDERS]}
    if not is_number(asked.at):
        return {"said": ["refused: a time is a number of seconds"]}
    return {"now": snapshot(shown.run, shown.fish, shown.room, asked.at)}


def make_app(shown: Shown, hosts: list[str]) -> FastAPI:
    """The server of a replay, for browsers that call it by one of these names."""
    app = guarded(FastAPI(openapi_url=None), hosts)
    add_pages(app)

    @app.post("/stop")
    async def stop() -> Response:
        return Response(NO_ORDERS, status_code=409)

    @app.websocket("/live")
    async def live(browser: WebSocket) -> None:
        if not await accepted(browser):
            return
        first = {
            "replay": _about(shown.run),
            "now": snapshot(shown.run, shown.fish, shown.room, 0.0),
        }
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await _tell(browser, first)
            async for text in messages(browser):
                await _tell(browser, _answer(shown, text))

    return app


async def _tell(browser: WebSocket, words: dict[str, Any]) -> None:
    whole = {"now": None, "said": [], "camera": False, **words}
    await browser.send_text(json.dumps(plain(whole), allow_nan=False))


@dataclass(frozen=True)
class ReplayConfig:
    """The log to show, host:port of the page, the fish as drawn (a file or a name, None: the one
    that the log tells), and length and width of the pool [m]."""

    log: Path
    page: str
    fish: str | None = None
    pool: tuple[float, float] = POOL


def replay(config: ReplayConfig, say: Callable[[str], None]) -> None:
    """Serve the replay of a log until Ctrl-C or SIGTERM. Raises BadInput."""
    run = read_run(config.log)
    shown = Shown(run, fish_in(config.log, config.fish), config.pool)
    with listen(address(config.page, "--page")) as listening:
        for line in announce(shown.run, listening.getsockname()):
            say(line)
        _serve(shown, listening)


def announce(run: Run, at: tuple[str, int]) -> list[str]:
    """Messages for the person: whether the log is complete, where the page is, who can see it."""
    lines = [] if run.whole else [f"{run.name}: cut off; the replay ends where the log ends"]
    lines.append(f"replay of {run.name}, {run.seconds:.1f} s: http://{at[0]}:{at[1]}/")
    if not is_local(at[0]):
        lines.append("warning: the replay is open to this network: everyone on it can watch.")
    return lines


def _serve(shown: Shown, listening: socket.socket) -> None:
    told_to_end()  # uvicorn ends at these signals and then raises them again
    server = make_server(make_app(shown, allowed_hosts(listening)))
    asyncio.run(serve(server, listening))
