"""The watchdog process turns torque off when the loop is killed or hangs, and
where half a packet was left on the bus."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from psutil import Process

from lines import PATIENT, XW430, Bench, servo_bench
from support import complaint, tailbeat_process
from tailbeat.files import BadInput
from tailbeat.robot import watchdog as watchdog
from tailbeat.robot.packet import WRITE, Packet, encode
from tailbeat.robot.servo import connect

pytestmark = pytest.mark.realtime

# A loop in miniature: it arms, keeps the servo's watchdog at bay, and tells the watchdog.
LOOP = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell has it ignored
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.robot import servo, watchdog
motor = servo.connect(sys.argv[1], hardware_of(load_fish("pulley-fish")), deadline=1.0)
with watchdog.guard(sys.argv[1]) as watcher:
    motor.prepare(-1.4, 1.4)
    watcher.beat(True)
    motor.arm(2.5)
    print("armed", flush=True)
    while True:
        watcher.beat(True)
        motor.write(0.3)
        time.sleep(0.02)
"""


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench() as made:
        yield made


@pytest.fixture
def loop(bench) -> Iterator[subprocess.Popen]:
    process = subprocess.Popen(
        [sys.executable, "-c", LOOP, bench.path], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stdout.readline() == b"armed\n" and bench.on
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate(timeout=30)  # until its watchdog is done too, else it meets the next test


def off_within(bench: Bench, seconds: float) -> float:
    began = time.monotonic()
    while bench.on:
        assert time.monotonic() - began < seconds, "torque is still on"
        time.sleep(0.002)
    return time.monotonic() - began


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGTERM, signal.SIGINT])
def test_whatever_ends_the_loop_the_torque_goes(bench, loop, number):
    os.kill(loop.pid, number)
    off_within(bench, 5.0)


def test_a_loop_that_is_stopped_while_it_holds_torque_is_ended_and_the_torque_goes(bench, loop):
    os.kill(loop.pid, signal.SIGSTOP)
    off_within(bench, 10.0)
    loop.wait(5)
    assert loop.returncode == -signal.SIGKILL


def test_a_loop_that_dies_beside_a_watchdog_that_hangs_leaves_it_to_the_spare(bench, loop):
    """Killed before the loop could notice, within its 0.4 s."""
    first, spare = sorted(Process(loop.pid).children(), key=lambda one: "spare" in one.cmdline())
    assert "spare" in spare.cmdline()
    first.suspend()
    time.sleep(0.1)
    loop.kill()
    try:
        assert off_within(bench, 5.0) < 1.5
    finally:
        first.kill()


def test_half_a_packet_of_the_dead_is_written_over(bench):
    bench.armed()
    whole = encode(Packet(1, WRITE, bytes.fromhex("740000080000")))
    for cut in range(1, len(whole)):
        time.sleep(0.1)  # replies to the last torque-off that are still under way
        bench.device.put(64, 1)
        bench.device.stream[:] = whole[:cut]
        assert watchdog.try_torque_off(bench.path, trying=5.0) == "" and not bench.on, cut


def test_a_late_reply_to_the_dead_loops_write_is_no_farewell(bench):
    bench.armed()
    goal = encode(Packet(1, WRITE, bytes.fromhex("740000080000")))
    end, bench.device.faults.late = os.open(bench.path, os.O_RDWR | os.O_NOCTTY), 0.03
    os.write(end, goal + goal[:13])  # one is answered late; half a one will swallow what comes next
    time.sleep(0.01)
    assert watchdog.try_torque_off(bench.path, trying=5.0) == "" and not bench.on
    os.close(end)


def test_a_latched_watchdog_and_replies_that_are_lost_do_not_keep_the_torque_on(bench):
    bench.armed()
    bench.device.trip()
    bench.device.faults.mute = 2
    assert watchdog.try_torque_off(bench.path, trying=5.0) == ""
    assert not bench.on and bench.device.get(98) == 0


def test_a_loop_that_says_farewell_is_left_alone_and_one_that_does_not_is_not(bench):
    for said, torque in ((True, True), (False, False)):
        bench.armed()
        with watchdog.guard(bench.path) as watcher:
            assert watcher.beat(True)
            if said:
                watcher.farewell()
        assert bench.on is torque


def test_a_watchdog_that_is_gone_is_noticed(bench):
    with watchdog.guard(bench.path) as watcher:
        assert watcher.beat(False)
        watcher.process.kill()
        watcher.process.wait()
        assert not watcher.beat(False)


@pytest.mark.thorough
@pytest.mark.parametrize("which", ["the first", "the spare"])
def test_a_watchdog_that_hangs_is_noticed_within_half_a_second_and_the_drive_still_ends(
    bench, which
):
    with watchdog.guard(bench.path) as watcher:
        one = watcher if which == "the first" else watcher.spare
        assert one is not None
        for _ in range(50):
            assert watcher.beat(True)
            time.sleep(0.02)
        os.kill(one.process.pid, signal.SIGSTOP)
        stopped = time.monotonic()
        while watcher.beat(True) and time.monotonic() - stopped < 5:
            time.sleep(0.02)
        assert time.monotonic() - stopped < 0.5
        os.kill(one.process.pid, signal.SIGCONT)
        time.sleep(0.1)
        watcher.beat(True)
        time.sleep(0.02)
        assert watcher.beat(True)  # it answers again
        watcher.farewell()


def test_a_loop_that_was_late_itself_does_not_blame_the_watchdog(bench):
    with watchdog.guard(bench.path) as watcher:
        assert watcher.beat(False)
        time.sleep(0.6)
        assert watcher.beat(False)
        watcher.farewell()


def test_what_cannot_be_told_is_said(bench, tmp_path):
    bench.armed()
    bench.pull()
    assert "could not open" in watchdog.try_torque_off(str(tmp_path / "nothing"), trying=0.1)
    assert "no such port" in complaint("torque-off", "--servo", tmp_path / "nothing")


def test_the_verb_lets_go(bench):
    bench.armed()
    done = tailbeat_process("torque-off", "--servo", bench.path)
    assert done.returncode == 0 and "torque is off" in done.stdout and not bench.on


def test_a_release_goes_on_from_where_the_servo_stopped_itself(bench):
    servo = connect(bench.path, XW430, deadline=PATIENT)
    servo.prepare(-1.4, 1.4)
    servo.arm(2.5)
    bench.device.shaft.angle = 0.4
    bench.device.trip()
    assert servo.stopped_itself()
    assert servo.release(2.5) == pytest.approx(0.4, abs=0.05)
    assert not servo.stopped_itself() and bench.on
    assert servo.write(0.2) == pytest.approx(0.2, abs=0.01)
    servo.close()


def test_a_watchdog_that_cannot_start_is_refused(monkeypatch):
    monkeypatch.setattr(watchdog.sys, "executable", "/bin/false")
    with pytest.raises(BadInput, match="did not start"), watchdog.guard("/dev/null"):
        pass
