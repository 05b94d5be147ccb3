"""The watchdog: a process that turns torque off when the loop fails, and a spare one.

The loop writes a byte into a pipe every period, and the watchdog answers it. The watchdog turns
torque off if the pipe closes without a farewell byte, or if no byte comes for a second while torque
is on. The loop stops if no answer comes for 0.4 s. It ignores what ends the loop (Ctrl-C, SIGTERM)
and needs neither network nor policy.

The spare does the same half a second later: a loop may die before it notices that its watchdog
hangs. If all three processes die, `ExecStopPost` of the systemd unit does the same.
"""

import contextlib
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import serial

from tailbeat.files import BadInput
from tailbeat.fish.description import Family
from tailbeat.processes import start
from tailbeat.robot.servo import DEADLINE, FAMILIES, ServoFault, on_port
from tailbeat.robot.wire import GONE

HELD, FREE, FAREWELL = b"t", b".", b"q"
SILENCE = 1.0  # s without a byte while torque is on: the loop hangs
TRYING = 10.0  # s that it tries to turn torque off: a cable may be plugged in again
LAST_ID, FASTEST = 252, 4_500_000  # of a servo, and its baud rate (e-manual, X series, 7 and 8)
START = 30.0  # s for the watchdog to start
DEAF = 0.4  # s without an answer: the watchdog hangs
SPARE, LATER = "spare", 0.5  # s after which the spare acts: the first is done in 0.1 s, or hangs


# ---- the loop's end -----------------------------------------------------------------------------


@dataclass(eq=False)
class Watchdog:
    """A running watchdog. Call `beat` every period, and `farewell` once torque is off. `answered`
    [s] is when its last answer was read, `asked` [s] when it was asked last. `spare`: another that
    acts later."""

    process: subprocess.Popen[bytes]
    answered: float = field(default_factory=time.monotonic)
    asked: float = math.inf
    spare: "Watchdog | None" = None

    def beat(self, torque: bool) -> bool:
        """Tell watchdog and spare that the loop runs; returns whether both still answer."""
        spared = self.spare is None or self.spare.beat(torque)
        return self._beat(torque) and spared

    def _beat(self, torque: bool) -> bool:
        now = time.monotonic()
        if self._hears() or now - self.asked > DEAF / 2:  # else the loop itself was late
            self.answered = now
        self.asked = now
        return self._say(HELD if torque else FREE) and now - self.answered < DEAF

    def _hears(self) -> bool:
        """Whether an answer has come since the last call."""
        assert self.process.stdout is not None
        try:
            return bool(os.read(self.process.stdout.fileno(), 4096))
        except OSError:
            return False

    def farewell(self) -> None:
        """Tell watchdog and spare that torque is off and they may end."""
        self._say(FAREWELL)
        if self.spare is not None:
            self.spare.farewell()

    def _say(self, byte: bytes) -> bool:
        assert self.process.stdin is not None
        try:
            os.write(self.process.stdin.fileno(), byte)
            return True
        except BlockingIOError:
            return True  # it runs, but reads slowly
        except OSError:
            return False


@contextmanager
def guard(
    path: str, ident: int = 1, baud: int = 1_000_000, families: Sequence[Family] = FAMILIES
) -> Iterator[Watchdog]:
    """Start a watchdog and its spare for the servo on a port, before anything moves. They speak to
    a servo of the `families`. Raises BadInput."""
    words = ["-m", "tailbeat.robot.watchdog", path, str(ident), str(baud), *families]
    made = [
        start([*words, *more], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for more in ([], [SPARE])
    ]
    if not all(map(_is_ready, made)):
        for process in made:
            process.kill()
            process.wait()
        raise BadInput(
            "the watchdog process did not start, so the robot will not arm; torque would stay on"
            " if the loop failed. Start the drive again."
        )
    try:
        yield Watchdog(made[0], spare=Watchdog(made[1]))
    finally:
        _part(made)


def _is_ready(process: subprocess.Popen[bytes]) -> bool:
    """Wait until a watchdog says that it watches; then its pipes no longer block."""
    assert process.stdin is not None and process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START)
    if not ready or process.stdout.readline() != b"ready\n":
        return False
    for pipe in (process.stdin, process.stdout):
        os.set_blocking(pipe.fileno(), False)
    return True


def _part(made: Sequence[subprocess.Popen[bytes]]) -> None:
    """Close the pipes, and wait until the watchdogs have done what they must."""
    for process in made:
        assert process.stdin is not None
        process.stdin.close()
    end = time.monotonic() + TRYING + LATER + 1
    for process in made:
        try:
            process.wait(max(end - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            process.kill()  # it hangs, and torque is off
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


# ---- the watchdog's end ------------------------------------------------------------------------


def watch(pipe: int, parent: int) -> bool:
    """Wait for the loop to end; returns whether torque may still be on.

    Kills a loop that hangs while torque is on.
    """
    last = b""
    while True:
        ready, _, _ = select.select([pipe], [], [], SILENCE)
        if ready:
            data = os.read(pipe, 4096)
            if not data:
                return last != FAREWELL
            last = data[-1:]
            _answer()
        elif last == HELD and os.getppid() == parent:
            os.kill(parent, signal.SIGKILL)
            return True


def _answer() -> None:
    """Tell the loop that it is watched; a loop that reads no more is not waited for."""
    with contextlib.suppress(OSError):
        os.write(1, FREE)


def try_torque_off(
    path: str,
    ident: int = 1,
    baud: int = 1_000_000,
    trying: float = TRYING,
    families: Sequence[Family] = FAMILIES,
) -> str:
    """Try to turn torque off until it is confirmed; "" on success, else the last error.

    The port may be in use. Half-written packets of a dead process on the bus do no harm, and
    neither do packets of a family that the servo does not understand.
    """
    end, said = time.monotonic() + trying, "not tried"
    while time.monotonic() < end:
        try:
            _once(path, ident, baud, families)
            return ""
        except (ServoFault, ValueError, *GONE) as fault:
            said = str(fault)
            time.sleep(0.02)
    return said


def torque_off(servo: str, ident: int, baud: int) -> None:
    """Turn the servo's torque off. Raises BadInput if the servo does not confirm it."""
    if not Path(servo).exists():
        raise BadInput(f"--servo {servo}: no such port; give the servo's port, like /dev/ttyUSB0.")
    if not 0 <= ident <= LAST_ID:
        raise BadInput(f"--id {ident}: give 0 to {LAST_ID}.")
    if not 0 < baud <= FASTEST:
        raise BadInput(f"--baud {baud}: give 1 to {FASTEST}.")
    said = try_torque_off(servo, ident, baud, trying=3.0)
    if said:
        raise BadInput(f"{servo}: {said}; TORQUE MAY BE ON: cut the servo's power.")


def _once(path: str, ident: int, baud: int, families: Sequence[Family]) -> None:
    """Try each family three times with one opening of the port. Raises ServoFault, or one of
    `GONE`."""
    with serial.Serial(path, baud, timeout=DEADLINE) as port:
        servos = [on_port(port, family, ident, 4 * DEADLINE) for family in families]
        for left in range(3 * len(servos) - 1, -1, -1):
            try:
                servos[-1 - left % len(servos)].torque_off()
                return
            except ServoFault:
                if left == 0:
                    raise


def main() -> None:
    """`python -m tailbeat.robot.watchdog PORT ID BAUD [FAMILY ...] [now | spare]`: watch standard
    input, then turn torque off; with `now` at once, with `spare` half a second later. Without a
    family it tries all. Exit code 1 if torque may still be on."""
    path, ident, baud = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    families = [one for one in FAMILIES if one in sys.argv[4:]] or FAMILIES
    if "now" not in sys.argv[4:]:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        parent = os.getppid()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        os.set_blocking(1, False)
        if not watch(sys.stdin.fileno(), parent):
            return
    if spare := SPARE in sys.argv[4:]:
        time.sleep(LATER)
    said = try_torque_off(path, ident, baud, families=families)
    if said or not spare:  # the first has said it
        print(f"tailbeat: {said or 'the loop failed; torque is off'}", file=sys.stderr, flush=True)
    sys.exit(1 if said else 0)


if __name__ == "__main__":
    main()
