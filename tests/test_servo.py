"""The servo's driver and the emulated servo: the maker's vectors, the maker's library, real bytes
over a pseudo-terminal, and what goes wrong on a bus."""

import math
import os
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, Bench, servo_bench
from support import until
from tailbeat.emulators import packet as emulated_packet
from tailbeat.emulators.servo_commands import ALERT
from tailbeat.files import BadInput
from tailbeat.robot.dynamixel_tables import X
from tailbeat.robot.packet import (
    PING,
    READ,
    REBOOT,
    STATUS,
    WRITE,
    Packet,
    Parser,
    crc16,
    encode,
)  # fmt: skip
from tailbeat.robot.servo import Servo, ServoFault, connect

pytestmark = pytest.mark.realtime


def raw(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


# ROBOTIS e-manual, protocol 2.0
SENT = [
    (Packet(1, PING), "FF FF FD 00 01 03 00 01 19 4E"),
    (Packet(1, READ, raw("84 00 04 00")), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (
        Packet(1, WRITE, raw("74 00 00 02 00 00")),
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    ),
    (Packet(1, REBOOT), "FF FF FD 00 01 03 00 08 2F 4E"),
]
HEARD = [
    (Packet(1, STATUS, raw("00 06 04 26")), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    (Packet(1, STATUS, raw("00 A6 00 00 00")), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    (Packet(1, STATUS, raw("00")), "FF FF FD 00 01 04 00 55 00 A1 0C"),
]


# ---- bytes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("packet", "text"), SENT + HEARD)
def test_packets_are_the_maker_s(packet, text):
    assert encode(packet) == raw(text)
    assert Parser().feed(raw(text)) == [packet]


@pytest.mark.parametrize(("packet", "text"), SENT)
def test_the_emulator_reads_the_maker_s_packets(packet, text):
    assert emulated_packet.take(bytearray(raw(text))) == (1, packet.instruction, packet.parameters)


@pytest.mark.parametrize(("packet", "text"), HEARD)
def test_the_emulator_writes_the_maker_s_replies(packet, text):
    assert emulated_packet.status(1, packet.parameters[0], packet.parameters[1:]) == raw(text)


def test_the_two_codecs_agree_on_random_bodies_full_of_headers():
    rng = np.random.default_rng(0)
    for _ in range(300):
        body = bytes(rng.choice([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x07], rng.integers(1, 40)).tolist())
        packet = Packet(1, STATUS, body)
        assert encode(packet) == emulated_packet.status(1, body[0], body[1:])
        assert Parser().feed(encode(packet)) == [packet]
        assert emulated_packet.take(bytearray(encode(Packet(1, WRITE, body)))) == (1, WRITE, body)


def test_a_parser_finds_packets_in_garbage_in_pieces_and_counts_the_damaged():
    rng, parser = np.random.default_rng(1), Parser()
    good = [Packet(1, STATUS, rng.bytes(9)) for _ in range(20)]
    broken = bytearray(encode(good[0]))
    broken[9] ^= 0x10
    stream = b"".join(rng.bytes(5) + encode(one) for one in good) + bytes(broken) + encode(good[1])
    found = []
    for first in range(0, len(stream), 3):
        found += parser.feed(stream[first : first + 3])
    assert found == [*good, good[1]] and parser.bad >= 1
    assert crc16(b"123456789") == 0xFEE8  # CRC-16/BUYPASS's published check value


# ---- over the line ------------------------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench() as made:
        yield made


@pytest.fixture
def servo(bench) -> Iterator[Servo]:
    opened = connect(bench.path, XW430, deadline=PATIENT)
    yield opened
    opened.close()


def test_the_maker_s_library_pings_reads_writes_and_reboots_the_emulator(bench, monkeypatch):
    sdk = pytest.importorskip("dynamixel_sdk")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 100)  # ms; the emulator is a thread
    port, packets = sdk.PortHandler(bench.path), sdk.PacketHandler(2.0)
    assert port.openPort()

    def heard(call: Callable[..., tuple[int, ...]], *words: int) -> tuple[int, ...]:
        """On a busy machine even that is too short: it asks again."""
        for _ in range(20):
            time.sleep(0.05)  # a late reply to the last try would be taken for this one's
            port.ser.reset_input_buffer()  # codespell:ignore ser
            try:
                answer = call(port, *words)
            except IndexError:  # it did
                continue
            if answer[-2] == sdk.COMM_SUCCESS:
                break
        return answer

    assert heard(packets.ping, 1) == (XW430.number, 0, 0)
    assert heard(packets.write4ByteTxRx, 1, 116, 2300) == (0, 0)
    assert heard(packets.read4ByteTxRx, 1, 116) == (2300, 0, 0)
    assert heard(packets.write1ByteTxRx, 1, 64, 1) == (0, 0)
    assert heard(packets.write1ByteTxRx, 1, 9, 0) == (0, sdk.ERRNUM_ACCESS)  # EEPROM, torque on
    assert heard(packets.write4ByteTxRx, 1, 116, 9000) == (0, sdk.ERRNUM_DATA_LIMIT)
    bench.device.fail(0)  # voltage: an alert beside valid data
    value, result, error = heard(packets.read4ByteTxRx, 1, 116)
    assert (value, result, error) == (2300, 0, ALERT)
    assert packets.reboot(port, 1)[0] == 0
    port.closePort()


def test_the_shaft_follows_and_is_read_in_radians(bench, servo):
    servo.prepare(-1.4, 1.4)
    assert servo.arm(watchdog=2.0) == pytest.approx(0.0, abs=X.count)
    sent = servo.write(0.5)
    assert sent == pytest.approx(0.5, abs=X.count / 2)
    until(lambda: abs(servo.read().angle - sent) < 2 * X.count)
    state = servo.read()
    assert (state.voltage, state.temperature, state.alert) == (12.0, 30.0, False)
    assert state.time <= time.monotonic()
    servo.torque_off()
    assert not servo.is_on()


def test_arming_removes_the_profile_that_another_program_left(bench, servo):
    bench.device.put(112, 40)
    bench.device.put(108, 3)
    servo.prepare(-1.4, 1.4)
    assert bench.device.get(112) == bench.device.get(108) == 0


def test_a_mirrored_servo_counts_the_other_way(bench):
    servo = connect(bench.path, XW430, sign=-1, deadline=PATIENT)
    servo.prepare(-1.0, 1.4)
    bench.device.shaft.angle = -0.3
    until(lambda: servo.read().angle == pytest.approx(0.3, abs=X.count))
    low, high = bench.device.get(52), bench.device.get(48)
    assert (high - 2048) * X.count == pytest.approx(1.0, abs=X.count)
    assert (2048 - low) * X.count == pytest.approx(1.4, abs=X.count)
    servo.close()


def test_a_tail_that_drifts_backwards_needs_stuffing_and_is_read_right(bench, servo):
    """Current -1 and velocity -3 put FF FF FD into the reply."""
    bench.device.faults.frozen = True
    bench.device.put(126, -1)
    bench.device.put(128, -3)
    state = servo.read()
    assert state.velocity == pytest.approx(-3 * X.velocity)
    assert state.current == pytest.approx(-XW430.current_unit)


def test_arming_holds_where_the_shaft_stands_and_never_jumps(bench, servo):
    bench.device.shaft.angle = 0.8
    servo.prepare(-1.4, 1.4)
    assert servo.arm(2.0) == pytest.approx(0.8, abs=X.count)
    time.sleep(0.1)
    assert bench.device.shaft.angle == pytest.approx(0.8, abs=2 * X.count)


# ---- what goes wrong ----------------------------------------------------------------------------


def test_a_lost_or_damaged_reply_to_a_read_is_asked_for_again(bench, servo):
    bench.device.faults.mute = 1
    servo.deadline = 0.1
    assert servo.read().voltage == 12.0 and servo.silent == 1
    bench.device.faults.corrupt = 1
    bench.device.faults.garbage = b"\xff\xff\xfd\x00\x01\xff\xff noise"
    assert servo.read().voltage == 12.0 and servo.parser.bad >= 1


def test_a_servo_that_stays_silent_is_told_in_time(bench, servo):
    bench.device.faults.mute = 10
    servo.deadline = 0.05
    began = time.monotonic()
    with pytest.raises(ServoFault, match="no reply within 50 ms") as told:
        servo.read()
    assert told.value.kind == "silent" and time.monotonic() - began < 5.0  # not for ever
    bench.device.faults.mute = 0


def test_a_late_reply_is_not_taken_for_the_next_one(bench, servo):
    servo.deadline, bench.device.faults.late = 0.05, 0.08
    bench.device.shaft.angle = 0.2
    servo.read()  # the first try's reply comes during the second's
    bench.device.shaft.angle = -0.4
    time.sleep(0.1)
    servo.deadline = PATIENT
    assert servo.read().angle == pytest.approx(-0.4, abs=X.count)


def test_the_servo_s_own_watchdog_stops_it_and_says_so_until_armed_anew(bench, servo):
    servo.prepare(-1.4, 1.4)
    servo.arm(watchdog=0.06)
    servo.write(1.0)
    began = bench.device.now
    until(lambda: bench.device.get(98) == 0xFF)
    assert bench.device.now - began < 0.3
    here = bench.device.shaft.angle
    with pytest.raises(ServoFault, match="watchdog") as told:
        servo.write(1.2)
    assert told.value.kind == "watchdog"
    assert bench.device.shaft.angle == pytest.approx(here, abs=0.02)
    assert servo.arm(2.0) == pytest.approx(here, abs=0.02)


def test_a_shutdown_is_seen_named_and_ended_by_a_reboot_alone(bench, servo):
    servo.prepare(-1.4, 1.4)
    servo.arm(2.0)
    bench.device.fail(5)
    state = servo.read()
    assert state.alert and not servo.is_on() and servo.hardware_errors() == ["overload"]
    with pytest.raises(ServoFault, match="result fail"):
        servo.arm()
    servo.reboot()
    with pytest.raises(ServoFault):  # deaf while it restarts
        servo.deadline = 0.02
        servo.read()
    servo.deadline = PATIENT
    until(lambda: bench.device.now > bench.device.quiet_until)
    assert servo.hardware_errors() == [] and not servo.is_on()


def test_a_pulled_cable_is_one_kind_of_fault_and_closing_does_not_raise(bench, servo):
    bench.pull()
    with pytest.raises(ServoFault) as told:
        servo.read()
    assert told.value.kind in ("gone", "silent")
    servo.close()


def test_closing_lets_go(bench):
    servo = connect(bench.path, XW430, deadline=PATIENT)
    servo.prepare(-1.4, 1.4)
    servo.arm(5.0)  # more than it can count: 2.54 s
    assert bench.device.get(64) == 1
    servo.close()
    until(lambda: bench.device.get(64) == 0)


def test_a_port_that_is_someone_else_s_is_refused(bench, tmp_path):
    with pytest.raises(BadInput, match="give the servo's port"):
        connect(str(tmp_path / "nothing"), XW430)
    bench.device.put(7, 9)  # another id
    with pytest.raises(BadInput, match="no servo 1 answers"):
        connect(bench.path, XW430, deadline=0.05)
    bench.device.put(7, 1)
    bench.device.put(0, 1060)  # an XL430
    with pytest.raises(BadInput, match="number 1060 answers, the fish's XW430-T200-R has 1280"):
        connect(bench.path, XW430, deadline=PATIENT)


def test_units_are_the_manual_s():
    assert math.degrees(X.count) == pytest.approx(0.087890625)
    assert X.velocity == pytest.approx(0.02398, abs=1e-5)


def test_a_process_that_stands_still_after_a_write_has_no_cable_out(servo, monkeypatch):
    """pyserial looks at the clock after it has written, and raises if the process stood still."""
    write, here = os.write, threading.get_ident()

    def slowly(number: int, data: bytes) -> int:
        done = write(number, data)
        if threading.get_ident() == here:
            time.sleep(0.15)
        return done

    monkeypatch.setattr(os, "write", slowly)
    assert math.isfinite(servo.read().angle)
    monkeypatch.setattr(os, "write", lambda number, data: 0)  # a line that takes nothing
    monkeypatch.setattr("select.select", lambda *lists: ([], [], []))
    with pytest.raises(ServoFault, match="took no bytes"):
        servo.read()
