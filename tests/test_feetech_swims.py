"""A fish with a Feetech servo: the 50 Hz loop, the doctor, the watchdog process and the verbs."""

import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from lines import PATIENT, STS3215, servo_bench, sts_fish
from support import complaint, tailbeat, tailbeat_process, until
from tailbeat.emulators.feetech import OVERLOAD
from tailbeat.files import BadInput
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.link.status import State
from tailbeat.robot import doctor_devices
from tailbeat.robot.doctor_devices import NO_WATCHDOG, check_before_driving
from tailbeat.robot.findings import ADVICE, BAD, OK, WARN, Finding
from tailbeat.robot.safety import SafetyLimits, limits_for
from tailbeat.robot.servo import connect
from test_loop import WIDE, Bench, driven

pytestmark = pytest.mark.realtime("robot")

FISH = load_fish("pulley-fish").model_copy(update={"hardware": STS3215})
POLICY = "pulley-fish-pool-generator"


@pytest.fixture
def fish(tmp_path: Path) -> Path:
    return sts_fish(tmp_path)


# ---- the loop -----------------------------------------------------------------------------------


@pytest.fixture
def swimming() -> Iterator[Bench]:
    with driven(FISH) as made:
        yield made


def test_the_loop_arms_swims_nearer_and_turns_torque_off(swimming):
    swimming.swim()
    first = math.hypot(1.5 - swimming.rig.shaft.pose[0], 0.5 - swimming.rig.shaft.pose[1])
    swimming.ticks(lambda: len([r for r in swimming.rows if r["state"] == "run"]) > 250)
    last = math.hypot(1.5 - swimming.rig.shaft.pose[0], 0.5 - swimming.rig.shaft.pose[1])
    assert last < first - 0.1 and swimming.torque == 1
    assert swimming.rig.servo.get(9) == 2048 - 910  # the policy's range, in the servo itself
    assert swimming.loop.disarm().state is State.DISARMED and swimming.torque == 0


def test_an_overload_stops_the_swim_and_a_restart_too(swimming):
    swimming.swim()
    swimming.rig.servo.fail(OVERLOAD)
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 5.0)
    assert "hardware error" in swimming.loop.safety_status.text and swimming.torque == 0
    swimming.loop.disarm()
    swimming.rig.servo.reboot()
    swimming.rig.servo.quiet_until = 0.0
    swimming.ticks(lambda: not swimming.loop.sensors.servo.alert)
    swimming.swim()
    swimming.rig.servo.reboot()
    swimming.rig.servo.quiet_until = 0.0
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 5.0)
    assert "lost its torque" in swimming.loop.safety_status.text and swimming.torque == 0


def test_a_silent_servo_stops_and_is_let_go_when_it_answers_again(swimming):
    swimming.swim()
    swimming.rig.servo.faults.mute = 10**6
    swimming.loop.devices.servo.deadline = 0.02
    swimming.loop.limits = SafetyLimits(**{**vars(WIDE), "servo_hold": 0.3, "servo_stop": 0.6})
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 10.0)
    assert swimming.loop.torque.owing  # nobody has confirmed it
    swimming.rig.servo.faults.mute = 0
    swimming.ticks(lambda: not swimming.loop.torque.owing, 10.0)
    assert swimming.torque == 0


def test_its_limits_know_no_watchdog_of_its_own():
    limits = limits_for(STS3215)
    assert not limits.own_watchdog and limits.temperature_hold == 55.0
    assert limits.current_stop == pytest.approx(2.16)


def test_the_table_of_the_documentation_is_the_catalogue_s(fish):
    assert hardware_of(load_fish(str(fish))) == STS3215


# ---- the doctor ---------------------------------------------------------------------------------

REGISTERS = {
    "servo supply": (62, 39, BAD), "servo temperature": (63, 60, BAD), "servo torque": (40, 1, BAD),
    "servo mode": (33, 1, WARN), "servo limits": (9, 2100, BAD), "servo turns": (18, 12 | 16, BAD),
    "servo phase": (18, 12 | 129, BAD), "servo unloading": (19, 0, BAD),
    "servo position gain": (21, 16, WARN),
}  # fmt: skip


def examined(path: str) -> dict[str, Finding]:
    """What the doctor finds; asked again if the emulator, a thread, answered too late."""
    for _ in range(3):
        servo, answer = doctor_devices.find_servo(path, STS3215, deadline=PATIENT)
        assert servo is not None, answer
        found = doctor_devices.check_servo(servo, STS3215)
        servo.port.close()
        if "servo" not in {one.name for one in found}:
            break
    return {one.name: one for one in found}


def test_a_well_servo_is_well_but_for_the_watchdog_that_it_lacks():
    with servo_bench(STS3215) as bench:
        before = bytes(bench.device.table.bytes[:56])
        found = examined(bench.path)
        assert bytes(bench.device.table.bytes[:56]) == before  # no register was written
    slow = {"servo reading time"}
    assert {name for name, one in found.items() if one.verdict != OK} - slow == {
        "servo's own watchdog"
    }
    assert found["servo's own watchdog"].do == NO_WATCHDOG


@pytest.mark.parametrize("name", REGISTERS)
def test_a_register_that_is_wrong_is_found(name):
    address, value, verdict = REGISTERS[name]
    with servo_bench(STS3215) as bench:
        bench.device.put(address, value)
        found = examined(bench.path)
        assert found[name].verdict == verdict
        if verdict == BAD and name in ("servo turns", "servo phase", "servo unloading"):
            assert found[name].do == ADVICE[name]
            servo = connect(bench.path, STS3215, deadline=PATIENT)
            with pytest.raises(BadInput, match=name):
                check_before_driving(bench.path, servo, STS3215)
            servo.close()


def test_a_servo_at_another_rate_is_found_there_and_told_how_to_set_it():
    with servo_bench(STS3215) as bench:
        bench.device.put(6, 4)
        servo, answer = doctor_devices.find_servo(bench.path, STS3215, deadline=PATIENT)
    assert servo is None and answer.found == "at 115200 baud, not at 1000000"
    assert f"tailbeat prepare --servo {bench.path}" in answer.do


# ---- the watchdog process -----------------------------------------------------------------------

LOOP = """
import sys, time
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.robot import servo, watchdog
hardware = hardware_of(load_fish(sys.argv[2]))
motor = servo.connect(sys.argv[1], hardware, deadline=0.25)
with watchdog.guard(sys.argv[1], families=[hardware.family]) as watcher:
    motor.prepare(-1.4, 1.4)
    watcher.beat(True)
    motor.arm()
    print("armed", flush=True)
    while True:
        watcher.beat(True)
        motor.write(0.3)
        time.sleep(0.02)
"""


@pytest.mark.thorough
def test_the_watchdog_process_turns_torque_off_after_a_kill(fish):
    with servo_bench(STS3215) as bench:
        words = [sys.executable, "-c", LOOP, bench.path, str(fish)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"armed\n" and bench.on
            process.send_signal(signal.SIGKILL)
            until(lambda: not bench.on)
            process.communicate(timeout=30)


# ---- the verbs ----------------------------------------------------------------------------------


def test_torque_off_needs_no_fish():
    with servo_bench(STS3215) as bench:
        bench.armed()
        done = tailbeat("torque-off", "--servo", bench.path)
        assert done.returncode == 0 and not bench.on, done.stderr


@pytest.mark.thorough
def test_emulate_and_drive_take_the_servo_from_the_fish(fish, tmp_path):
    """In real time, in processes of their own; a busy host may make the loop hold: then again."""
    for attempt in range(4):
        log = tmp_path / f"swim{attempt}.mcap"
        words = ("--emulated", "--fish", fish, "--log", log, "--seconds", 10)
        done = tailbeat_process("drive", POLICY, *words)
        assert done.returncode in (0, 1), done.stderr
        assert NO_WATCHDOG in " ".join(done.stdout.split())
        if "run: swimming" in done.stdout:
            return
    raise AssertionError(done.stdout)


def test_the_table_of_faults_is_a_dynamixel_s(fish):
    said = complaint("faults", "--fish", fish, "--only", "voltage sags")
    assert "the faults are those of a Dynamixel" in said
