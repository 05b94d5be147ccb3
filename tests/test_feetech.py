"""The Feetech driver over real bytes: packets, units, and what goes wrong on a bus."""

import time
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from hypothesis import given
from hypothesis import strategies as st

from lines import PATIENT, STS3215, XW430, Bench, servo_bench
from support import until
from tailbeat.emulators import feetech_packet as emulated
from tailbeat.emulators.feetech import OVERHEATED, OVERLOAD
from tailbeat.files import BadInput
from tailbeat.robot import feetech_tables as driver
from tailbeat.robot.feetech_packet import (
    PING,
    READ,
    WRITE,
    Packet,
    Parser,
    encode,
    signed,
    with_sign,
)
from tailbeat.robot.feetech_tables import STS
from tailbeat.robot.servo import Servo, ServoFault, connect
from tailbeat.robot.watchdog import try_torque_off


def raw(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


# The maker's protocol manual: ping and reading the position of id 1, and the answers.
SENT = [
    (Packet(1, PING), "FF FF 01 02 01 FB"),
    (Packet(1, READ, raw("38 02")), "FF FF 01 04 02 38 02 BE"),
    (Packet(1, WRITE, raw("2A 00 08 00 00 E8 03")), "FF FF 01 09 03 2A 00 08 00 00 E8 03 D5"),
]
HEARD = [
    (Packet(1, 0), "FF FF 01 02 00 FC"),
    (Packet(1, 0, raw("18 05")), "FF FF 01 04 00 18 05 DD"),
]


# ---- bytes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("packet", "text"), SENT + HEARD)
def test_packets_are_the_maker_s(packet, text):
    assert encode(packet) == raw(text)
    assert Parser().feed(raw(text)) == [packet]


def test_the_emulator_s_codec_is_another_one_and_agrees():
    rng = np.random.default_rng(0)
    for packet, text in SENT:
        assert emulated.take(bytearray(raw(text))) == (1, packet.instruction, packet.parameters)
    for packet, text in HEARD:
        assert emulated.status(1, packet.instruction, packet.parameters) == raw(text)
    for _ in range(300):
        body = bytes(rng.choice([0xFF, 0xFF, 0x00, 0x07, 0x01], rng.integers(0, 40)).tolist())
        whole = encode(Packet(1, READ, body))
        assert whole == emulated.status(1, READ, body)
        assert Parser().feed(whole) == [Packet(1, READ, body)]
        assert emulated.take(bytearray(whole)) == (1, READ, body)


def test_a_parser_finds_packets_in_garbage_in_pieces_and_counts_the_damaged():
    rng, parser = np.random.default_rng(1), Parser()
    good = [Packet(1, 0, bytes([2, 3, k])) for k in range(20)]
    broken = bytearray(encode(good[0]))
    broken[6] ^= 0x10
    stream = b"".join(rng.bytes(5) + encode(one) for one in good) + bytes(broken) + encode(good[1])
    found = []
    for first in range(0, len(stream), 3):
        found += parser.feed(stream[first : first + 3])
    assert [one for one in found if one in good] == [*good, good[1]] and parser.bad >= 1


@given(st.integers(-2047, 2047))
def test_a_sign_is_a_bit_beside_the_magnitude(number):
    assert signed(with_sign(number)) == number == signed(with_sign(number, 11), 11)
    assert (with_sign(number) >> 15) == (number < 0)


# ---- the driver ---------------------------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench(STS3215) as made:
        yield made


@pytest.fixture
def servo(bench) -> Iterator[Servo]:
    opened = connect(bench.path, STS3215, deadline=PATIENT)
    yield opened
    opened.close()


@pytest.mark.realtime
def test_the_shaft_follows_and_is_read_in_si_units(bench, servo):
    servo.prepare(-1.4, 1.4)
    assert servo.arm() == pytest.approx(0.0, abs=STS.count)
    sent = servo.write(0.5)
    assert sent == pytest.approx(0.5, abs=STS.count / 2)
    until(lambda: abs(servo.read().angle - sent) < 2 * STS.count)
    bench.device.faults.frozen = True
    bench.device.put(58, -300)
    bench.device.put(69, -100)
    state = servo.read()
    assert (state.voltage, state.temperature, state.alert) == (12.0, 30.0, False)
    assert state.velocity == pytest.approx(-300 * STS.count)
    assert state.current == pytest.approx(-0.65) and state.time <= time.monotonic()
    servo.torque_off()
    assert not servo.is_on() and not bench.on


@pytest.mark.realtime
def test_a_mirrored_servo_counts_the_other_way_and_speeds_have_the_phase_s_unit(bench):
    bench.device.put(18, 8)  # speeds in 50 counts/s
    servo = connect(bench.path, STS3215, sign=-1, deadline=PATIENT)
    servo.prepare(-1.0, 1.4)
    bench.device.shaft.angle = -0.3
    until(lambda: servo.read().angle == pytest.approx(0.3, abs=STS.count))
    low, high = bench.device.get(9), bench.device.get(11)
    assert (high - 2048) * STS.count == pytest.approx(1.0, abs=STS.count)
    assert (2048 - low) * STS.count == pytest.approx(1.4, abs=STS.count)
    bench.device.faults.frozen = True
    bench.device.put(58, 4)
    assert servo.read().velocity == pytest.approx(-4 * 50 * STS.count)
    servo.close()


@pytest.mark.realtime
@pytest.mark.parametrize(("phase", "speed"), [(12, 0), (4, 3400), (0, 68), (8, 0)])
def test_arming_asks_for_the_fastest_speed_in_each_meaning_of_it(bench, servo, phase, speed):
    bench.device.put(18, phase)
    bench.device.put(46, 100)
    bench.device.put(41, 5)
    servo.prepare(-1.4, 1.4)
    assert bench.device.get(46) == speed and bench.device.get(41) == 0


@pytest.mark.realtime
def test_a_limit_that_no_register_holds_is_a_fault(servo):
    with pytest.raises(ServoFault, match="register 9 takes 0 to 65535, not -103"):
        servo.prepare(-3.3, 1.4)


@pytest.mark.realtime
def test_what_arming_sets_is_kept_without_power(bench, servo):
    bench.device.put(33, 1)
    servo.prepare(-1.4, 1.4)
    limits = bench.device.get(9), bench.device.get(11)
    bench.device.reboot()
    assert (bench.device.get(9), bench.device.get(11)) == limits != (0, 4095)
    assert bench.device.get(33) == 0


@pytest.mark.realtime
def test_arming_holds_where_the_shaft_stands_and_claims_no_watchdog(bench, servo):
    bench.device.shaft.angle = 0.8
    servo.prepare(-1.4, 1.4)
    assert servo.arm() == pytest.approx(0.8, abs=STS.count)
    time.sleep(0.1)
    assert bench.device.shaft.angle == pytest.approx(0.8, abs=2 * STS.count)
    assert not servo.own_watchdog and not servo.stopped_itself()
    servo.torque_off()
    bench.device.shaft.angle = 1.5
    until(lambda: servo.read().angle > 1.45)
    with pytest.raises(ServoFault, match="outside its limits"):
        servo.arm()
    assert not bench.on


@pytest.mark.realtime
def test_a_register_that_is_not_taken_is_told_because_the_servo_does_not_tell(bench, servo):
    written_ = bench.device.table.write
    bench.device.table.write = lambda at, data: None if at == 33 else written_(at, data)
    bench.device.put(33, 1)
    with pytest.raises(ServoFault, match="register 33 holds 1 after writing 0") as told:
        servo.prepare(-1.4, 1.4)
    assert told.value.kind == "refused" and bench.device.get(55) == 1  # the lock is closed


@pytest.mark.realtime
def test_an_overload_is_seen_and_named_and_arming_fails_until_a_restart(bench, servo):
    servo.prepare(-1.4, 1.4)
    servo.arm()
    bench.device.fail(OVERLOAD)
    state = servo.read()
    assert state.alert and not servo.is_on() and servo.hardware_errors() == ["overload"]
    table, written_ = bench.device.table, bench.device.table.write
    table.write = lambda at, data: None if at == 40 else written_(at, data)
    with pytest.raises(ServoFault, match="torque did not come on: overload"):
        servo.arm()
    table.write = written_
    servo.reboot()
    until(lambda: bench.device.now > bench.device.quiet_until)
    assert servo.hardware_errors() == [] and not servo.is_on()
    bench.device.fail(OVERHEATED)
    assert servo.hardware_errors() == ["overheat"]


@pytest.mark.realtime
def test_lost_damaged_and_echoed_replies_are_asked_for_again_or_told(bench, servo):
    bench.device.faults.mute = 1
    assert servo.read().voltage == 12.0 and servo.silent == 1
    bench.device.faults.corrupt = 1
    bench.device.faults.garbage = b"\xff\xff\x01 noise"
    assert servo.read().voltage == 12.0
    bench.device.faults.garbage = encode(Packet(1, READ, bytes([3, 2])))  # as a request comes back
    assert servo.get(driver.MODEL) == 777
    bench.device.faults.mute, servo.deadline = 10, 0.05
    with pytest.raises(ServoFault, match="no reply within 50 ms") as told:
        servo.read()
    assert told.value.kind == "silent"
    bench.device.faults.mute, servo.deadline = 0, PATIENT
    bench.pull()
    with pytest.raises(ServoFault) as gone:
        servo.read()
    assert gone.value.kind in ("gone", "silent")


@pytest.mark.realtime
def test_another_servo_rate_or_level_is_refused_in_a_sentence(bench):
    sts3250 = STS3215.model_copy(update={"number": 2825, "model": "STS3250"})
    with pytest.raises(BadInput, match="number 777 answers, the fish's STS3250 has 2825"):
        connect(bench.path, sts3250, deadline=PATIENT)
    with pytest.raises(BadInput, match="no servo 1 answers at 500000 baud"):
        connect(bench.path, STS3215, baud=500_000, deadline=0.05)
    bench.device.put(8, 0)
    with pytest.raises(BadInput, match=r"response level .* is 0.*tailbeat prepare --servo"):
        connect(bench.path, STS3215, deadline=PATIENT)


@pytest.mark.realtime
def test_torque_goes_off_without_knowing_the_family():
    for hardware in (STS3215, XW430):
        with servo_bench(hardware) as bench:
            bench.armed()
            assert try_torque_off(bench.path, trying=20.0) == "" and not bench.on
