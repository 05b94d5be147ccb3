"""Messages of browsers: one JSON object each, read strictly. Whoever reaches the page sends them.

Anything else is one refusal: other JSON, names twice, numbers that are not finite, nesting without
end, characters that are no text, bytes instead of text.
"""

import json
import math
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

from fastapi import WebSocket

NO_COMMAND = "refused: not a command"


@dataclass(frozen=True)
class Message:
    """What a browser asks: the command, its token, and `at`, a place or a time."""

    do: str
    token: str = ""
    at: Any = None


def read_message(text: str) -> Message | None:
    """The message in a text, or None if it is none."""
    try:
        asked = json.loads(text, object_pairs_hook=_once, parse_float=_finite, parse_int=_finite,
                           parse_constant=_finite)  # fmt: skip
        message = Message(**{name: asked[name] for name in ("do", "token", "at") if name in asked})
        message.token.encode()  # half of a character is no text
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return message if isinstance(message.do, str) and isinstance(message.token, str) else None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object. Raises ValueError for a name that stands there twice."""
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a name twice")
    return dict(pairs)


def _finite(word: str) -> float:
    """A number. Raises ValueError for one that is not finite."""
    number = float(word)
    if not math.isfinite(number):
        raise ValueError("not finite")
    return number


def is_number(value: Any) -> bool:
    """Whether a value of a message is a number."""
    return isinstance(value, float)


async def messages(browser: WebSocket) -> AsyncIterator[str]:
    """What a browser sends until it is gone; "" in place of bytes, which are no message."""
    while (came := await browser.receive())["type"] == "websocket.receive":
        yield came.get("text") or ""


def same_origin(origin: str | None, host: str | None) -> bool:
    """Whether our own page asks, or no page at all. Pages of other sites are refused."""
    return origin is None or origin in (f"http://{host}", f"https://{host}")


async def accepted(browser: WebSocket) -> bool:
    """Accept a browser that shows our own page, and close the connection to any other."""
    if not same_origin(browser.headers.get("origin"), browser.headers.get("host")):
        await browser.close(1008)
        return False
    await browser.accept()
    return True
