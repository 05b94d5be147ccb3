"""Feetech's SCS servos: the high byte of a word first, ten bits over 300 degrees, another lock. The
maker's `scscl`, another maker's client and our driver complete a session over real bytes."""

import math
from collections.abc import Iterator
from functools import partial
from typing import get_args

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, Bench, heard_by, servo_bench
from support import tailbeat, until
from tailbeat.emulators.feetech import OVERHEATED, Feetech
from tailbeat.emulators.feetech_table import SCS
from tailbeat.fish.description import Family, Hardware
from tailbeat.fish.store import load_fish
from tailbeat.robot import feetech_tables as tables
from tailbeat.robot import prepare
from tailbeat.robot.doctor_devices import check_servo
from tailbeat.robot.findings import BAD
from tailbeat.robot.safety import limits_for
from tailbeat.robot.servo import connect

SCS0009 = Hardware(
    family="feetech-scs", make="Feetech", model="SCS0009", number=1284, supply=6.0,
    supply_range=(4.0, 7.4), current_unit=0.001, current_limit=0.8, temperature_limit=80.0,
    gain=15,
)  # fmt: skip
FISH = load_fish("pulley-fish").model_copy(update={"hardware": SCS0009})
COUNT = math.radians(300) / 1024


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench(SCS0009) as made:
        yield made


# ---- other people's clients ---------------------------------------------------------------------


@pytest.mark.realtime
def test_the_maker_s_library_completes_a_session(bench):
    sdk = pytest.importorskip("scservo_sdk")
    port = sdk.PortHandler(bench.path)
    assert port.openPort() and port.setBaudRate(1_000_000)
    client = sdk.scscl(port)

    heard = partial(heard_by, sdk.COMM_SUCCESS)
    assert heard(client.ping, 1) == (1284, 0, 0)
    heard(client.unLockEprom, 1)
    assert heard(client.write2ByteTxRx, 1, 11, 900) == (0, 0)
    heard(client.LockEprom, 1)
    assert bench.device.table.stored[11:13] == b"\x03\x84"  # 900, its high byte first
    heard(client.write1ByteTxRx, 1, 40, 1)
    heard(client.WritePos, 1, 700, 0, 1000)
    until(lambda: heard(client.ReadPos, 1)[0] == 700)
    assert bench.device.shaft.angle == pytest.approx((700 - 511) * COUNT, abs=COUNT)
    bench.device.faults.frozen = True
    bench.device.put(58, -300)
    assert heard(client.ReadPosSpeed, 1)[:2] == (700, -300)
    bench.device.fail(OVERHEATED)
    assert heard(client.ReadPos, 1)[2] == sdk.ERRBIT_OVERHEAT and not bench.on
    port.closePort()


def test_registers_are_those_of_other_people_s_clients():
    rustypot = pytest.importorskip("rustypot")
    theirs = {one.addr: one for one in rustypot.Scs0009PyController.registers()}
    for address, register in SCS.registers.items():
        if address in theirs and address != 46:  # here a speed has no sign
            assert (theirs[address].size, theirs[address].sign_bit) == (
                register.size,
                register.sign,
            ), address
    sdk = pytest.importorskip("scservo_sdk.scscl")
    assert tables.SCS.lock == (sdk.SCSCL_LOCK, 1) == (SCS.lock, 1)
    assert tables.GOAL[0] == sdk.SCSCL_GOAL_POSITION_L and tables.TIME[0] == sdk.SCSCL_GOAL_TIME_L
    assert tables.LOWEST[0] == sdk.SCSCL_MIN_ANGLE_LIMIT_L
    assert rustypot.Scs0009PyController.models() == {"SCS0009": SCS0009.number}
    assert rustypot.Scs0009PyController.word_order() == tables.SCS.order == SCS.order


@pytest.mark.realtime
def test_angles_are_those_of_a_client_by_other_people(bench):
    rustypot = pytest.importorskip("rustypot")
    client = rustypot.Scs0009PyController(bench.path, 1_000_000, 0.5)
    bench.device.faults.frozen = True
    for counts in (20, 511, 1003):
        bench.device.put(56, counts)
        (angle,) = client.read_present_position(1)
        assert angle == pytest.approx((counts - tables.SCS.centre) * tables.SCS.count, abs=1e-6)
    bench.device.put(58, 256)
    assert client.read_present_speed(1)[0] == pytest.approx(256 * tables.SCS.speed_unit(0))
    client.close()


# ---- ours ---------------------------------------------------------------------------------------


@pytest.mark.realtime
def test_the_driver_arms_follows_and_reads_in_si_units(bench):
    servo = connect(bench.path, SCS0009, deadline=PATIENT)
    servo.prepare(-1.4, 1.4)
    assert (bench.device.get(9), bench.device.get(11)) == (237, 785)
    assert servo.arm() == pytest.approx(0.0, abs=COUNT) and bench.on
    sent = servo.write(-0.5)
    assert sent == pytest.approx(-0.5, abs=COUNT / 2)
    until(lambda: abs(servo.read().angle - sent) < 2 * COUNT)
    bench.device.faults.frozen = True
    for address, value in ((58, -200), (69, 700), (63, 41)):
        bench.device.put(address, value)
    state = servo.read()
    assert (state.current, state.voltage, state.temperature) == pytest.approx((0.7, 6.0, 41.0))
    assert state.velocity == pytest.approx(-200 * COUNT)
    assert not servo.own_watchdog and not limits_for(SCS0009).own_watchdog
    servo.close()
    assert not bench.on


@pytest.mark.realtime
@pytest.mark.parametrize(("phase", "speed"), [(8, 0), (0, 1023)])
def test_arming_asks_for_the_fastest_speed_in_each_meaning_of_it(bench, phase, speed):
    bench.device.put(18, phase)
    bench.device.put(44, 500)
    servo = connect(bench.path, SCS0009, deadline=PATIENT)
    servo.prepare(-1.0, 1.0)
    assert (bench.device.get(46), bench.device.get(44)) == (speed, 0)
    servo.close()


@pytest.mark.realtime
def test_prepare_and_doctor_use_its_table(bench, monkeypatch):
    assert set(prepare.LISTEN) == set(get_args(Family))
    monkeypatch.setitem(prepare.LISTEN, "feetech-scs", PATIENT)
    for address, value in {5: 7, 6: 4, 8: 0, 9: 0, 11: 0, 19: 0, 44: 50}.items():
        bench.device.put(address, value)
    looked = prepare.look(bench.path, FISH)
    assert looked.found == prepare.Found(115_200, 7, 1284)
    changes = prepare.write(bench.path, FISH, looked)
    assert len(changes) == len(looked.wrong) and all(one.done for one in changes)
    assert bench.device.get(48) == 1  # its lock is closed again
    servo = connect(bench.path, SCS0009, deadline=PATIENT)
    assert not [one for one in check_servo(servo, SCS0009) if one.verdict == BAD]
    bench.device.put(18, 1)
    bad = [one.name for one in check_servo(servo, SCS0009) if one.verdict == BAD]
    assert bad == ["servo phase"]  # reversed
    servo.close()


@pytest.mark.realtime
def test_torque_goes_off_without_knowing_the_family(bench):
    bench.armed()
    done = tailbeat("torque-off", "--servo", bench.path)
    assert done.returncode == 0 and not bench.on, done.stderr


def test_a_motor_without_limits_holds_no_angle():
    servo = Feetech(hardware=SCS0009)
    for address, value in ((9, 0), (11, 0), (40, 1), (42, 800)):
        servo.put(address, value)
    servo.advance(0.5)
    assert servo.shaft.angle == 0.0
