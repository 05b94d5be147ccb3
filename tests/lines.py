"""An emulated device on a pseudo-terminal, served by a thread, for the tests of the drivers."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tailbeat.pool.servo import close_line, open_line


@contextmanager
def served(serve: Callable[..., None], device: Any) -> Iterator[tuple[str, Callable[[], None]]]:
    """The port that a driver opens, and how to pull its cable."""
    line, ended = open_line(), threading.Event()
    thread = threading.Thread(target=serve, args=(device, line, ended.is_set), daemon=True)
    thread.start()

    def pull() -> None:
        if not ended.is_set():
            ended.set()
            thread.join(2)
            close_line(line)

    yield line.path, pull
    pull()
