"""Start emulated devices as a process."""

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE

from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.addresses import address
from tailbeat.link.places import POOL, as_text
from tailbeat.processes import end, start_verb, temporary
from tailbeat.robot.fits import NONE
from tailbeat.robot.ports import Ports

KINDS = ("bno055", "bno085")  # of emulated IMUs


@contextmanager
def own_devices(
    fish: str,
    seed: int,
    target: str = "",
    page: str = "",
    imu: str = "",
    say: Callable[[str], None] = print,
    pool: tuple[float, float] = POOL,
) -> Iterator[tuple[Ports, Path]]:
    """Start emulated devices and yield their ports and key; `say` gets the operator page's address.
    `target` is x,y [m], "" for the default. `imu` is one of `KINDS`, "" for the first, or "none".
    `pool`: its length and width [m]. Raises BadInput."""
    if imu not in ("", NONE, *KINDS):
        raise BadInput(f"--imu {imu}: with --emulated, allowed are {', '.join(KINDS)} and {NONE}.")
    with temporary() as folder:
        key = Path(folder) / "rig.key"
        link.make_key(key)
        listen = link.free_address()
        words = ["emulate", "--fish", fish, "--key", str(key)]
        words += ["--robot", f"{listen[0]}:{listen[1]}"]
        words += [f"--target={target}", "--seed", str(seed), "--page", page]
        words += ["--pool", as_text(pool), "--imu", imu if imu in KINDS else KINDS[0]]
        process = start_verb(words, stdout=PIPE)
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            if not line:
                raise BadInput("the emulated devices did not start; see the message above.")
            said = json.loads(line)
            for told in said["page"]:
                say(told)
            station = address(said["station"], "station")
            port = NONE if imu == NONE else said["imu"]
            yield Ports(said["servo"], port, listen, station), key
        finally:
            end(process, signal.SIGTERM)
