"""The doctor: every check is shown to fail on a device, a file or a link that is really broken."""

import fcntl
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import XW430, served
from support import tailbeat, tailbeat_process
from tailbeat.emulators.imu import Bno055
from tailbeat.emulators.imu import serve as serve_imu
from tailbeat.emulators.servo import Dynamixel
from tailbeat.emulators.servo import serve as serve_servo
from tailbeat.link import datagrams as link
from tailbeat.robot import doctor, doctor_computer, doctor_devices, doctor_link
from tailbeat.robot.findings import ADVICE, BAD, OK, WARN, Finding

pytestmark = pytest.mark.realtime("robot")

PATIENT = 0.25


@dataclass
class Bench:
    device: Dynamixel
    sensor: Bno055
    servo: str
    imu: str
    pull: Callable[[], None]


@pytest.fixture
def bench() -> Iterator[Bench]:
    device, sensor = Dynamixel(), Bno055()
    with served(serve_servo, device) as (servo, pull), served(serve_imu, sensor) as (imu, _):
        yield Bench(device, sensor, servo, imu, pull)


def of_servo(bench: Bench) -> dict[str, Finding]:
    """What is found; asked again if the emulator, a thread of this process, answered too late."""
    for _ in range(3):
        if "servo" not in (found := _asked(bench)):
            break
    return found


def _asked(bench: Bench) -> dict[str, Finding]:
    servo, answer = doctor_devices.find_servo(bench.servo, XW430, deadline=PATIENT)
    if servo is None:
        return {answer.name: answer}
    found = doctor_devices.check_servo(servo, XW430)
    servo.port.close()
    return {one.name: one for one in [answer, *found]}


def of_imu(bench: Bench) -> dict[str, Finding]:
    imu, answer = doctor_devices.find_imu(bench.imu, XW430, deadline=PATIENT)
    if imu is None:
        return {answer.name: answer}
    found = doctor_devices.check_imu(imu, XW430)
    imu.close()
    return {one.name: one for one in [answer, *found]}


def test_well_devices_are_well_and_nothing_was_moved(bench):
    before = bytes(bench.device.table.bytes[:120])
    found = of_servo(bench)
    assert {one.name for one in found.values() if one.verdict == BAD} == set()
    assert bytes(bench.device.table.bytes[:120]) == before  # no register was written
    assert {one.verdict for one in of_imu(bench).values()} == {OK}


REGISTERS = {
    "servo firmware": (6, 40, WARN), "servo supply": (144, 91, BAD),
    "servo temperature": (146, 70, BAD), "servo torque": (64, 1, BAD),
    "servo stopped itself": (98, 0xFF, WARN), "servo mode": (11, 16, WARN),
    "servo return delay": (9, 250, WARN), "servo limits": (52, 2100, BAD),
    "servo drive mode": (10, 1, BAD), "servo homing offset": (20, 100, WARN),
    "servo shutdown": (63, 0, BAD), "servo hardware error": (70, 0b100, BAD),
}  # fmt: skip


@pytest.mark.parametrize("name", REGISTERS)
def test_a_register_that_is_wrong_is_found(bench, name):
    address, value, verdict = REGISTERS[name]
    bench.device.put(9, 0)
    bench.device.put(address, value)
    found = of_servo(bench)
    assert found[name].verdict == verdict and found[name].do == ADVICE[name]
    rest = {one.name for one in found.values() if one.verdict != OK and one.name != name}
    follows = {"servo hardware error"} if name == "servo supply" else set()  # it reports that too
    assert rest - {"servo reading time"} == follows


def test_a_servo_at_another_baud_rate_is_found_there_and_one_without_power_is_not(bench):
    bench.device.put(8, 1)
    found = of_servo(bench)["servo answers"]
    assert found.verdict == BAD and found.found == "at 57600 baud, not at 1000000"
    assert f"tailbeat prepare --servo {bench.servo}" in found.do
    bench.device.put(8, 3)
    bench.device.faults.mute = 10**6
    servo, answer = doctor_devices.find_servo(bench.servo, XW430, deadline=0.01)
    assert servo is None and answer.verdict == BAD and "no reply within" in answer.found
    bench.device.faults.mute = 0


def test_a_slow_bus_is_found(bench):
    bench.device.faults.slow = 0.012
    assert of_servo(bench)["servo reading time"].verdict == BAD


def test_an_imu_that_is_wrong_is_found(bench):
    bench.sensor.table[0x3A] = 3
    assert of_imu(bench)["IMU's own error"].verdict == BAD
    bench.sensor.table[0x3A] = 0
    bench.sensor.rates = (0.0, 0.0, 1.0)
    assert of_imu(bench)["IMU at rest"].verdict == WARN
    bench.sensor.faults.frozen = True
    assert "same numbers" in of_imu(bench)["IMU"].found
    bench.sensor.table[0] = 0x83
    assert of_imu(bench)["IMU answers"].verdict == BAD


def test_ports_that_are_absent_held_or_slow_are_found(bench, tmp_path):
    (absent,) = doctor_devices.check_port("port", str(tmp_path / "none"))
    assert absent.verdict == BAD and "by-id" in absent.do
    handle = os.open(bench.servo, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    (held,) = doctor_devices.check_port("port", bench.servo)
    assert held.verdict == BAD and "in use" in held.found
    os.close(handle)
    timer = tmp_path / Path(bench.servo).name / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    for waits, verdict in ((16, BAD), (2, WARN), (1, OK)):
        timer.write_text(f"{waits}\n")
        _, slow = doctor_devices.check_port("port", bench.servo, tmp_path)
        assert slow.verdict == verdict and slow.found == f"{waits} ms"


# ---- key and station -----------------------------------------------------------------------------


def test_keys_that_are_absent_open_to_others_or_short_are_found(tmp_path):
    assert (
        doctor_link.check_key(None).verdict
        == doctor_link.check_key(tmp_path / "none").verdict
        == BAD
    )
    link.make_key(tmp_path / "key")
    assert doctor_link.check_key(tmp_path / "key").verdict == OK
    (tmp_path / "key").chmod(0o644)
    assert "other users may read" in doctor_link.check_key(tmp_path / "key").found


KEY = bytes(32)


def station(made, key: bytes, ended: threading.Event, see: bool, skip: int, slow: float) -> None:
    """A tracker in miniature: answers, and sends sixty frames a second, some of them lost."""
    sequence, fish, nonce = 0, None, None
    while not ended.wait(1 / 60):
        now = time.monotonic_ns()
        for data, sender in link.drain(made):
            told = link.tell_datagram(key, 1, data, now, now)
            if told is not None:
                time.sleep(slow)
                made.sendto(told, sender)
                fish, nonce = sender, link.HEAD.unpack_from(data)[2]
        if nonce is None:
            continue
        sequence += 1
        frame = link.Frame(now - 40_000_000, (0.0, 0.0, 0.0) if see else None, None)
        if sequence % skip == 0:
            made.sendto(link.pose_datagram(key, 1, nonce, sequence, [frame]), fish)


@pytest.mark.parametrize(
    ("key", "see", "skip", "slow", "expected"),
    [
        (KEY, True, 1, 0.0, {"station answers": OK, "fish seen": OK, "target seen": WARN}),
        (KEY, False, 1, 0.0, {"fish seen": BAD}),
        (KEY, True, 5, 0.0, {"datagrams lost": BAD, "poses per second": BAD}),
        (KEY, True, 1, 0.12, {"clocks compared": BAD}),
        (KEY, True, 10**9, 0.0, {"poses": BAD}),
        (bytes(31) + b"x", True, 1, 0.0, {"station answers": BAD}),
    ],
    ids=["well", "no tag", "loss", "slow network", "no camera", "another key"],
)
def test_what_is_wrong_between_laptop_and_fish_is_found(key, see, skip, slow, expected):
    theirs, ours = link.bind("127.0.0.1", 0), link.bind("127.0.0.1", 0)
    ended = threading.Event()
    words = (theirs, key, ended, see, skip, slow)
    thread = threading.Thread(target=station, args=words, daemon=True)
    thread.start()
    receiver = link.Receiver(KEY, (5.5, 2.7))
    found = {
        one.name: one for one in doctor_link.check_link(ours, theirs.getsockname(), receiver, 1.0)
    }
    ended.set()
    thread.join()
    theirs.close()
    ours.close()
    assert {name: found[name].verdict for name in expected} == expected


# ---- this computer ------------------------------------------------------------------------------


def test_a_computer_that_is_not_ready_is_found(tmp_path, monkeypatch):
    assert doctor_computer.check_disk(tmp_path / "none").verdict == BAD
    monkeypatch.setattr(doctor_computer, "ROOM_BAD", 1e18)
    assert doctor_computer.check_disk(tmp_path).verdict == BAD
    governor = tmp_path / "cpu0" / "cpufreq" / "scaling_governor"
    governor.parent.mkdir(parents=True)
    governor.write_text("powersave\n")
    assert doctor_computer.check_governor(tmp_path).verdict == WARN
    wireless = tmp_path / "wireless"
    for level, verdict in ((-90, BAD), (-70, WARN), (-50, OK)):
        wireless.write_text(f"head\nhead\n wlan0: 0000   54.  {level}.  -256  0 0 0\n")
        assert doctor_computer.check_wireless(wireless).verdict == verdict


def test_rights_that_are_missing_are_found():
    code = (
        "import os, resource; resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536));"
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0)); os.geteuid = lambda: 1000;"
        "from tailbeat.robot.doctor_computer import check_scheduling;"
        "print([one.verdict for one in check_scheduling()])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "['warn', 'warn']", done.stderr


def test_a_policy_that_does_not_fit_is_found(tmp_path):
    (tmp_path / "x.onnx").write_bytes(b"no network")
    (broken,) = doctor.check_policy(str(tmp_path / "x.onnx"), "pulley-fish")
    assert broken.verdict == BAD
    _, other = doctor.check_policy("pulley-fish-pool-generator", "crank-fish")
    assert other.verdict == BAD and other.do


# ---- the verb -----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_emulated_bench_is_well_and_what_is_broken_is_exit_code_1(tmp_path):
    out = tmp_path / "found.json"
    done = tailbeat_process("doctor", "--emulated", "--json", out)
    rows = json.loads(out.read_text())["findings"]
    busy = {"servo reading time", "pose age", "poses per second"}  # a busy machine's, not the rig's
    bad = [row for row in rows if row["verdict"] == BAD and row["name"] not in busy]
    assert len(rows) > 30 and not bad, (bad, done.stderr)
    link.make_key(tmp_path / "key")
    out = tmp_path / "missing.json"  # a table breaks its lines
    words = ("--servo", tmp_path / "none", "--key", tmp_path / "key", "--json", out)
    assert tailbeat("doctor", *words).returncode == 1 and "does not exist" in out.read_text()
    done = tailbeat("doctor")
    assert done.returncode == 2 and "or --emulated" in done.stderr
