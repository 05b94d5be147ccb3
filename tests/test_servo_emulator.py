"""The emulated servo keeps its manual's rules, and strangers' clients can talk to it.

The maker's library and rustypot speak over real bytes; the rules are asked packet by packet.
"""

import math
import struct
from collections.abc import Callable

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from hypothesis import given, settings
from hypothesis import strategies as st

from lines import servo_bench
from support import until
from tailbeat.emulators.packet import checksum
from tailbeat.emulators.servo import Dynamixel
from tailbeat.emulators.servo_commands import ALERT
from tailbeat.emulators.servo_table import ACCESS, FAIL, LENGTH, LIMIT, RANGE
from tailbeat.robot.packet import Parser

READ, WRITE, SYNC_READ, FAST_SYNC = 0x02, 0x03, 0x82, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK, CLEAR, FACTORY = 0x92, 0x93, 0x9A, 0x10, 0x06


def packet(instruction: int, body: bytes, ident: int = 1) -> bytes:
    head = b"\xff\xff\xfd\x00" + struct.pack("<BHB", ident, len(body) + 3, instruction) + body
    return head + checksum(head)


def asked(servo: Dynamixel, instruction: int, body: bytes, ident: int = 1) -> tuple[int, bytes]:
    """Error and data of the answer; -1 if there is none."""
    found = list(Parser().feed(servo.answer(packet(instruction, body, ident))))
    return (found[0].parameters[0], found[0].parameters[1:]) if found else (-1, b"")


def written(servo: Dynamixel, address: int, value: int, size: int) -> int:
    data = (value % (1 << 8 * size)).to_bytes(size, "little")
    return asked(servo, WRITE, struct.pack("<H", address) + data)[0]


def turning(servo: Dynamixel, seconds: float) -> None:
    start = servo.now
    for step in range(1, round(seconds / 0.001) + 1):
        servo.heard = servo.now
        servo.advance(start + 0.001 * step)


# ---- what may be written ------------------------------------------------------------------------

REFUSED = {
    "operating mode 99": (11, 99, 1, RANGE),
    "operating mode 2": (11, 2, 1, RANGE),
    "position limit 9999": (48, 9999, 4, RANGE),
    "torque 7": (64, 7, 1, RANGE),
    "a short write": (116, 0, 2, LENGTH),
    "an address between two": (117, 0, 1, ACCESS),
    "a read-only register": (132, 0, 4, ACCESS),
    "an address without a register": (14, 0, 1, ACCESS),
    "gain 20000": (84, 20000, 2, RANGE),
    "id 253": (7, 253, 1, RANGE),
    "watchdog 128": (98, 128, 1, RANGE),
    "a goal beyond its limits": (116, 5000, 4, LIMIT),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_manual_refuses_is_refused_and_changes_nothing(name):
    address, value, size, error = REFUSED[name]
    servo = Dynamixel()
    before = bytes(servo.table.bytes)
    assert written(servo, address, value, size) == error
    assert bytes(servo.table.bytes) == before


def test_a_long_write_fills_whole_registers_or_none():
    servo = Dynamixel()
    assert asked(servo, WRITE, struct.pack("<HIII", 108, 10, 50, 2100))[0] == 0
    assert (servo.get(108), servo.get(112), servo.get(116)) == (10, 50, 2100)
    assert asked(servo, WRITE, struct.pack("<HIII", 108, 20, 60, 9000))[0] == LIMIT
    assert servo.get(108) == 10  # what came before the refused one was not written either
    assert asked(servo, WRITE, struct.pack("<H", 116))[0] == LENGTH


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=40), st.integers(0, 255))
def test_no_packet_ends_it_and_every_register_stays_allowed(body, instruction):
    servo = Dynamixel()
    servo.answer(packet(instruction, body))
    servo.advance(0.01)
    for address, register in servo.table.registers.items():
        if register.allowed is not None:
            assert servo.get(address, register.allowed[0] < 0) in register.allowed


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from([1, 0xFE]) | st.integers(0, 255),
    st.integers(0, 12) | st.integers(0, 0xFFFF),
    st.binary(max_size=30),
    st.binary(max_size=12),
)
def test_no_bytes_with_a_checksum_that_holds_end_it(ident, length, content, after):
    """Also of a packet whose length is too short for an instruction, or is another one's."""
    said = b"\xff\xff\xfd\x00" + struct.pack("<BH", ident, length) + content[: max(length - 2, 0)]
    servo = Dynamixel()
    servo.answer(said + checksum(said) + after)
    servo.advance(0.01)
    turning(servo, 0.02)
    servo.stream.clear()
    assert asked(servo, 0x01, b"", servo.get(7))[0] >= 0 or servo.now < servo.quiet_until


# ---- modes --------------------------------------------------------------------------------------


def test_a_profile_limits_the_speed_and_a_lower_one_limits_it_more():
    took = {}
    for units in (0, 40, 10):
        servo = Dynamixel()
        assert written(servo, 112, units, 4) == written(servo, 64, 1, 1) == 0
        assert written(servo, 116, 2048 + 512, 4) == 0
        turning(servo, 0.4)
        took[units] = servo.shaft.angle
    assert took[0] == pytest.approx(math.pi / 4, abs=0.02)
    for units in (40, 10):  # 0.229 rev/min each
        limit = units * 0.229 * 2 * math.pi / 60 * 0.4
        assert 0.5 * limit < took[units] <= 1.01 * limit


def test_drive_mode_and_homing_offset_are_seen_in_every_count():
    servo = Dynamixel()
    servo.shaft.angle = math.pi / 4
    servo.advance(0.001)
    assert servo.get(132) == 2048 + 512
    assert written(servo, 10, 1, 1) == 0
    servo.advance(0.002)
    assert servo.get(132) == 2048 - 512
    assert written(servo, 10, 0, 1) == written(servo, 20, 100, 4) == 0
    servo.advance(0.003)
    assert servo.get(132) == 2048 + 512 + 100
    assert written(servo, 64, 1, 1) == written(servo, 116, 2048 + 100, 4) == 0
    turning(servo, 0.5)
    assert servo.shaft.angle == pytest.approx(0.0, abs=0.01)


def test_only_modes_that_hold_a_position_turn_to_a_goal():
    for mode in (0, 1, 16):
        servo = Dynamixel()
        assert written(servo, 11, mode, 1) == written(servo, 64, 1, 1) == 0
        assert written(servo, 116, 2300, 4) == 0
        turning(servo, 0.3)
        assert servo.shaft.angle == 0.0


# ---- what goes wrong inside ---------------------------------------------------------------------


def test_a_low_supply_is_an_alert_and_heat_takes_the_torque():
    servo = Dynamixel()
    assert written(servo, 64, 1, 1) == 0
    servo.put(144, 94)
    servo.advance(0.01)
    error, data = asked(servo, READ, struct.pack("<HH", 70, 1))
    assert error == ALERT and data == b"\x01" and servo.get(64) == 1  # not in the shutdown mask
    servo.put(146, 80)
    servo.advance(0.02)
    assert servo.get(64) == 0 and written(servo, 64, 1, 1) == FAIL | ALERT
    servo.put(146, 40)
    servo.put(144, 120)
    servo.reboot()
    servo.advance(0.2)
    assert written(servo, 64, 1, 1) == 0


def test_the_bus_watchdog_takes_the_profile_and_refuses_goals():
    servo = Dynamixel()
    assert written(servo, 112, 40, 4) == written(servo, 98, 5, 1) == written(servo, 64, 1, 1) == 0
    servo.advance(0.2)
    assert servo.get(98) == 0xFF and servo.get(112) == 0 and servo.get(64) == 1
    assert written(servo, 116, 2100, 4) == RANGE
    assert written(servo, 98, 0, 1) == written(servo, 116, 2100, 4) == 0


# ---- instructions -------------------------------------------------------------------------------


def test_many_are_read_in_order_and_a_servo_alone_waits_for_no_other():
    servo = Dynamixel()
    part = struct.pack("<HH", 132, 4)
    centre = (2048).to_bytes(4, "little")
    assert asked(servo, SYNC_READ, part + b"\x01", 0xFE) == (0, centre)
    assert asked(servo, SYNC_READ, part + b"\x02\x01", 0xFE)[0] == -1  # 2 never answers
    for cut in (b"", b"\x84", part):
        assert asked(servo, SYNC_READ, cut, 0xFE)[0] == -1
    assert asked(servo, BULK_READ, b"\x01" + part, 0xFE) == (0, centre)
    for instruction, body in ((FAST_SYNC, part + b"\x01"), (FAST_BULK, b"\x01" + part)):
        assert asked(servo, instruction, body, 0xFE) == (0, b"\x01" + centre)


def test_bulk_write_clear_and_factory_reset():
    servo = Dynamixel()
    body = struct.pack("<BHHI", 2, 116, 4, 1900) + struct.pack("<BHHI", 1, 116, 4, 2200)
    assert asked(servo, BULK_WRITE, body, 0xFE)[0] == -1 and servo.get(116) == 2200
    assert asked(servo, CLEAR, b"\x01\x44\x58\x4c\x22")[0] == 0
    assert asked(servo, CLEAR, b"\x01")[0] == RANGE
    assert written(servo, 7, 9, 1) == 0 and servo.get(7) == 9
    assert asked(servo, FACTORY, b"\x01", 9)[0] == 0
    assert servo.get(7) == 9 and servo.get(116) == 2048
    assert asked(servo, FACTORY, b"\xff", 9)[0] == 0 and servo.get(7) == 1


# ---- strangers ----------------------------------------------------------------------------------


def patiently(call: Callable[..., object], *words: object) -> object:
    """Of a client that gives up after its own time: on a busy machine it is asked again."""
    for _ in range(5):
        try:
            return call(*words)
        except RuntimeError as error:
            said = error
    raise said


@pytest.mark.realtime
def test_a_client_by_other_people_drives_it():
    rustypot = pytest.importorskip("rustypot")
    with servo_bench() as bench:
        client = rustypot.Xl430PyController(bench.path, 1_000_000, 0.5)
        assert patiently(client.ping, 1)
        assert patiently(client.read_model_number, 1) == [1280]
        patiently(client.write_torque_enable, 1, 1)
        patiently(client.sync_write_goal_position, [1], [2300])
        until(lambda: patiently(client.sync_read_present_position, [1]) == [2300])
        assert bench.on
        patiently(client.write_operating_mode, 1, 99)  # it does not look at the error
        assert bench.device.get(11) == 3
        patiently(client.write_torque_enable, 1, 0)
        assert not bench.on
