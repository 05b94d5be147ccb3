"""A virtual camera in its own process: a fresh interpreter that films the scene it is given.

Both ends of the pipe are our own processes, and its messages are pickled. The camera
ends when the pipe does, so it does not outlive the process that started it.
"""

import contextlib
import gc
import os
import select
import socket
import subprocess
import threading
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

import cv2

from tailbeat.emulators.camera import Renderer, Scene
from tailbeat.emulators.film import Filming, listen, serve
from tailbeat.files import BadInput
from tailbeat.processes import ALONE, start

READY = 60.0  # s that the process may take to start
RUN = "import sys; from tailbeat.emulators.camera_process import work; work(*sys.argv[1:])"


@dataclass(eq=False)
class CameraProcess:
    """A virtual camera in a process of its own; see `start_camera`."""

    where: str  # what `open_camera` opens
    process: "subprocess.Popen[bytes]"
    pipe: Connection

    def show(self, scene: Scene) -> None:
        """Set the scene to film from now on."""
        with contextlib.suppress(OSError):
            if select.select([], [self.pipe], [], 0)[1]:
                self.pipe.send(scene)

    def close(self) -> None:
        """End the camera."""
        self.process.kill()
        self.process.wait()
        self.pipe.close()
        Path(self.where.removeprefix("unix:")).unlink(missing_ok=True)


def start_camera(path: Path, filming: Filming) -> CameraProcess:
    """Start a camera on a socket; it ends with its parent process. Raises BadInput."""
    listening = listen(path)
    ours, theirs = Pipe()
    handles = listening.fileno(), theirs.fileno()
    words = ["-c", RUN, *map(str, handles)]
    process = start(words, pass_fds=handles, stdin=subprocess.DEVNULL, env={**os.environ, **ALONE})
    listening.close()
    theirs.close()
    made = CameraProcess(f"unix:{path}", process, ours)
    if not _is_ready(ours, filming):
        made.close()
        raise BadInput(f"{path}: the virtual camera did not start; see its message above.")
    return made


def _is_ready(pipe: Connection, filming: Filming) -> bool:
    """Send the process its configuration, and wait until it is ready."""
    try:
        pipe.send(filming)
        return pipe.poll(READY) and pipe.recv() == "ready"
    except (EOFError, OSError):  # it has ended
        return False


def work(listening: str, pipe: str) -> None:
    """The process: films the scenes from the pipe and serves them on the socket; both are handle
    numbers."""
    told = Connection(int(pipe))
    filming: Filming = told.recv()
    cv2.setNumThreads(1)
    Renderer(filming.optics, filming.conditions).draw(
        Scene(), 0.0
    )  # compiled and cached in advance
    gc.freeze()
    shown, over = [Scene()], threading.Event()
    threading.Thread(target=_hear, args=(told, shown, over), daemon=True).start()
    told.send("ready")
    serve(socket.socket(fileno=int(listening)), filming, lambda: shown[0], over.is_set)


def _hear(told: Connection, shown: list[Scene], over: threading.Event) -> None:
    """Keep the newest scene, until the pipe ends."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            shown[0] = told.recv()
    over.set()
