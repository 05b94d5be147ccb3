"""Connect to Ray: of a cluster, or started on this machine and left when one of its processes
ends."""

import atexit
import contextlib
import logging
import os
import socket
import sys
import warnings
from collections.abc import Mapping
from typing import Any

import psutil
import ray
from ray._private import worker

from tailbeat.files import BadInput
from tailbeat.processes import LINGER, cores

OUTSIDE, CLIENTS = "ray://", 10001  # of an address; the port of `ray start` for them
# Ray's client from outside sends its token only if told; else the cluster seems not to answer.
TOKEN = " If it has a token of Ray's, copy it to this machine and set RAY_AUTH_MODE=token."
ANSWER = 5.0  # s that a cluster may take to answer
STORE = 100_000_000  # bytes of shared memory for Ray's objects; ours are small


class RayEnded(BadInput):
    """A process of the Ray that was started on this machine has ended."""


def connect(address: str | None) -> None:
    """Connect to a cluster, or start Ray on this machine's cores.

    `address` is auto or HOST:PORT of a cluster of which this machine is a node, or ray://HOST:PORT
    of another. A second call does nothing. Raises BadInput if nobody answers there, or if Ray
    does not start.
    """
    if ray.is_initialized():
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    logging.getLogger("ray").setLevel(logging.CRITICAL)  # we say in one line why a trial failed
    if address is None:
        _start(quiet)
        return
    try:
        _check_answers(address)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # we say in one line that nobody answers
            ray.init(address=address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        raise BadInput(
            f"--address {address}: no Ray cluster answers ({type(error).__name__}); allowed are"
            f" auto and HOST:PORT of a cluster of which this machine is a node, and"
            f" ray://HOST:{CLIENTS} of another. Start one with `ray start --head`, or omit"
            f" --address to use this machine alone.{TOKEN if address.startswith(OUTSIDE) else ''}"
        ) from None


def _start(quiet: Mapping[str, Any]) -> None:
    """Start Ray on this machine's cores. Raises BadInput."""
    try:
        ray.init(
            num_cpus=cores(),
            address="local",
            include_dashboard=False,
            object_store_memory=STORE,
            **quiet,
        )
    except Exception as error:  # Ray has no narrower one
        why = " ".join(str(error).split())
        raise BadInput(
            f"Ray did not start on this machine ({type(error).__name__}: {why}); mend that, then"
            f" run the command again with --resume."
        ) from None


def _check_answers(address: str) -> None:
    """Raises OSError or ValueError at once where Ray would try for minutes."""
    if address == "auto":
        return
    host, _, port = address.removeprefix(OUTSIDE).rpartition(":")
    if not host or "/" in host:
        raise ValueError(address)
    socket.create_connection((host, int(port)), timeout=ANSWER).close()


def disconnect() -> None:
    """Leave the cluster; Ray that was started on this machine ends."""
    ray.shutdown()


def ended() -> str | None:
    """The name of a process of the Ray that was started here that has ended, or None."""
    node: Any = worker._global_node
    return next((name for name, _ in node.dead_processes()), None) if node else None


def abandon() -> None:
    """End all processes that this one has started, trials too. When this one ends, it then exits
    with 2 at once: Ray's goodbye would wait a minute for what is gone, and end it with 1."""
    ours = psutil.Process().children(recursive=True)
    for one in ours:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.terminate()
    for one in psutil.wait_procs(ours, timeout=LINGER)[1]:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    atexit.register(_exit_at_once)


def _exit_at_once() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(2)
