"""A virtual camera in a process of its own: a fresh interpreter that films what it is shown.

Both ends of the pipe between the processes belong to us, and what they send is pickled. The camera
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
        """What is to be filmed from now on. A camera that hangs or is gone holds nobody up."""
        with contextlib.suppress(OSError):
            if select.select([], [self.pipe], [], 0)[1]:
                self.pipe.send(scene)

    def close(self) -> None:
        """Pull its cable."""
        self.process.kill()
        self.process.wait()
        self.pipe.close()
        Path(self.where.removeprefix("unix:")).unlink(missing_ok=True)


def start_camera(path: Path, filming: Filming) -> CameraProcess:
    """Start a camera on a socket; it ends with its parent. Raises BadInput."""
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
        raise BadInput(f"{path}: the virtual camera did not start; see what it said above.")
    return made


def _is_ready(pipe: Connection, filming: Filming) -> bool:
    """Tell the process what films, and wait until it can."""
    try:
        pipe.send(filming)
        return pipe.poll(READY) and pipe.recv() == "ready"
    except (EOFError, OSError):  # it is gone
        return False


def work(listening: str, pipe: str) -> None:
    """The process: films on the socket what comes down the pipe; both are numbers of handles."""
    told = Connection(int(pipe))
    filming: Filming = told.recv()
    cv2.setNumThreads(1)
    Renderer(filming.optics, filming.conditions).draw(Scene(), 0.0)  # made before anyone waits
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
