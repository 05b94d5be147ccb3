"""The emulated STS servo keeps its manual's rules, and other people's clients can talk to it.

The maker's SDK and rustypot speak over real bytes; the rules are asked packet by packet.
"""

import math
import struct
from collections.abc import Callable, Iterator
from functools import partial

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from hypothesis import given, settings
from hypothesis import strategies as st

from lines import STS3215, Bench, heard_by, servo_bench
from support import until
from tailbeat.emulators.feetech import OVERHEATED, Feetech
from tailbeat.emulators.feetech_table import REGISTERS
from tailbeat.robot import feetech_tables as driver
from tailbeat.robot.feetech_packet import (
    PING,
    READ,
    WRITE,
    Packet,
    Parser,
    encode,
)

REG_WRITE, ACTION, RESET, SYNC_READ, SYNC_WRITE = 0x04, 0x05, 0x06, 0x82, 0x83
EVERYONE = 0xFE


# ---- the emulated servo, packet by packet -------------------------------------------------------


def asked(servo: Feetech, instruction: int, body: bytes = b"", ident: int = 1) -> Packet | None:
    """The answer, if there is one."""
    found = Parser().feed(servo.answer(encode(Packet(ident, instruction, body))))
    return found[0] if found else None


def written(servo: Feetech, address: int, value: int, size: int = 1) -> Packet | None:
    return asked(servo, WRITE, bytes([address]) + value.to_bytes(size, "little"))


def turning(servo: Feetech, seconds: float) -> None:
    start = servo.now
    for step in range(1, round(seconds / 0.001) + 1):
        servo.advance(start + 0.001 * step)


NOT_TAKEN = {
    "mode 9": (33, 9, 1),
    "torque 7": (40, 7, 1),
    "id 254": (5, 254, 1),
    "baud 8": (6, 8, 1),
    "highest position 5000": (11, 5000, 2),
    "half a register": (42, 1, 1),
    "a read-only register": (56, 3, 2),
    "an address without a register": (70, 3, 1),
}


@pytest.mark.parametrize("name", NOT_TAKEN)
def test_what_the_manual_does_not_allow_is_not_taken_and_answered_like_any_other(name):
    address, value, size = NOT_TAKEN[name]
    servo = Feetech()
    before = bytes(servo.table.bytes)
    assert written(servo, address, value, size) == Packet(1, 0)
    assert bytes(servo.table.bytes) == before


ADDRESS, SIZE = st.integers(0, 255), st.integers(0, 255) | st.integers(248, 255)
SAID = (
    st.tuples(st.integers(0, 255), st.binary(max_size=40))
    | st.tuples(st.just(READ), st.tuples(ADDRESS, SIZE).map(bytes))
    | st.tuples(st.just(SYNC_READ), st.tuples(ADDRESS, SIZE, st.just(1)).map(bytes))
)


@settings(max_examples=300, deadline=None)
@given(SAID, st.sampled_from([1, EVERYONE]))
def test_no_packet_ends_it_and_every_register_stays_allowed(said, ident):
    instruction, body = said
    servo = Feetech()
    servo.answer(encode(Packet(ident, instruction, body)))
    servo.advance(0.01)
    for address, register in REGISTERS.items():
        if register.allowed is not None:
            assert servo.get(address) in register.allowed


def test_the_eeprom_is_kept_only_while_its_lock_is_open():
    servo = Feetech()
    written(servo, 5, 9)
    assert servo.get(5) == 9  # at once
    servo.reboot()
    servo.advance(0.2)
    assert servo.get(5) == 1  # but not without power
    for address, value in ((55, 0), (5, 9)):
        written(servo, address, value)
    servo.reboot()
    servo.advance(0.4)
    assert servo.get(5) == 9 and servo.get(55) == 1
    assert asked(servo, RESET, ident=9) is not None and servo.get(5) == 9 and servo.get(11) == 4095


def test_other_ids_broadcasts_damaged_packets_and_a_low_response_level_get_no_answer():
    servo = Feetech()
    state = bytes([56, 2])
    assert asked(servo, READ, state, ident=2) is None
    assert asked(servo, READ, state, ident=EVERYONE) is None
    assert asked(servo, WRITE, b"\x28\x01", ident=EVERYONE) is None and servo.on
    assert asked(servo, PING, ident=EVERYONE) == Packet(1, 0)
    damaged = bytearray(encode(Packet(1, READ, state)))
    damaged[-1] ^= 1
    assert servo.answer(bytes(damaged)) == b""
    assert asked(servo, 0x77) is None
    servo.put(8, 0)
    assert written(servo, 40, 0) is None and servo.get(40) == 0  # obeyed, not answered
    assert asked(servo, READ, state) is not None and asked(servo, PING) is not None


def test_many_are_read_and_written_and_a_registered_write_waits():
    servo = Feetech()
    assert asked(servo, SYNC_READ, bytes([56, 2, 1]), EVERYONE) == Packet(1, 0, b"\x00\x08")
    assert asked(servo, SYNC_READ, bytes([56, 2, 2, 1]), EVERYONE) is None  # 2 never answers
    body = bytes([42, 2, 2]) + struct.pack("<H", 1900) + b"\x01" + struct.pack("<H", 2200)
    assert asked(servo, SYNC_WRITE, body, EVERYONE) is None and servo.get(42) == 2200
    assert asked(servo, REG_WRITE, b"\x2a\x00\x07") == Packet(1, 0)
    assert servo.get(42) == 2200 and servo.get(64) == 1
    assert asked(servo, ACTION, ident=EVERYONE) is None and servo.get(42) == 1792


def test_goals_are_kept_within_the_limits_and_reached_at_the_speed_asked():
    servo, slow = Feetech(), Feetech()
    slow.put(46, 341)  # counts/s: 30 degrees a second
    for one in (servo, slow):
        one.put(11, 2048 + 512)
        written(one, 40, 1)
        written(one, 42, 4000, 2)
        turning(one, 0.5)
    assert servo.shaft.angle == pytest.approx(math.pi / 4, abs=0.01) and servo.get(67) == 2560
    assert slow.shaft.angle == pytest.approx(0.5 * math.radians(30), abs=0.03)
    slow.put(18, 0)  # then speed 0 is standstill
    slow.put(46, 0)
    here = slow.shaft.angle
    turning(slow, 0.2)
    assert slow.shaft.angle == pytest.approx(here, abs=0.03)


def test_the_middle_can_be_calibrated_and_a_turn_wraps():
    servo = Feetech()
    servo.shaft.angle = 0.5
    servo.advance(0.001)
    assert servo.get(56) == 2048 + 326
    written(servo, 40, 128)
    servo.advance(0.002)
    assert servo.get(56) == 2048 and not servo.on
    servo.put(31, 0)
    servo.shaft.angle = -3.5
    servo.advance(0.003)
    assert servo.get(56) == 2048 - 2282 + 4096
    servo.put(18, servo.get(18) | 16)
    servo.advance(0.004)
    assert servo.get(56) == 2048 - 2282 and servo.table.bytes[57] >> 7  # the sign bit


@pytest.mark.parametrize(
    ("address", "value", "bit", "seconds"),
    [(62, 39, 0, 0.01), (63, 70, 2, 0.01), (69, 600, 3, 2.1), (60, 900, 5, 2.1)],
    ids=["voltage", "heat", "current", "overload"],
)
def test_errors_are_bits_of_every_answer_and_take_the_torque_if_the_memory_says_so(
    address, value, bit, seconds
):
    servo = Feetech()
    written(servo, 40, 1)
    servo.put(address, value)
    turning(servo, seconds)
    answer = asked(servo, READ, bytes([65, 1]))
    assert answer == Packet(1, 1 << bit, bytes([1 << bit]))
    assert servo.on == (bit == 0)  # 0 is not in the unloading condition
    free = Feetech()
    free.put(19, 0)
    written(free, 40, 1)
    free.put(address, value)
    turning(free, seconds)
    assert free.on and free.get(65) == 1 << bit


# ---- strangers ----------------------------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[Bench]:
    with servo_bench(STS3215) as made:
        yield made


def patiently(call: Callable[..., object], *words: object) -> object:
    """Of a client that gives up after its own time: on a busy machine it is asked again."""
    for _ in range(5):
        try:
            return call(*words)
        except RuntimeError as error:
            said = error
    raise said


@pytest.mark.realtime
def test_a_client_by_other_people_completes_a_session(bench):
    rustypot = pytest.importorskip("rustypot")
    client = rustypot.Sts3215PyController(bench.path, 1_000_000, 0.5)
    assert patiently(client.ping, 1) and patiently(client.read_model_number, 1) == [777]
    patiently(client.write_raw_lock, 1, 0)
    patiently(client.write_raw_min_position_limit, 1, 1000)
    patiently(client.write_raw_lock, 1, 1)
    assert patiently(client.read_raw_min_position_limit, 1) == [1000]
    patiently(client.write_raw_torque_enable, 1, 1)
    patiently(client.write_raw_goal_position, 1, 2300)
    until(lambda: patiently(client.read_raw_present_position, 1) == [2300])
    until(lambda: patiently(client.sync_read_raw_present_position, [1]) == [2300])
    assert patiently(client.read_present_voltage, 1) == [120] and bench.on
    patiently(client.write_raw_torque_enable, 1, 0)
    assert not bench.on and patiently(client.read_raw_torque_enable, 1) == [0]
    client.close()


def test_addresses_and_signs_are_those_of_a_client_by_other_people():
    rustypot = pytest.importorskip("rustypot")
    theirs = {one.addr: one for one in rustypot.Sts3215PyController.registers()}
    for address, register in REGISTERS.items():
        if address in theirs and address != 24:  # one register of two bytes there
            assert theirs[address].size == register.size, address
            own = None if address in (69,) else register.sign
            assert theirs[address].sign_bit == own, address
    ours = [driver.MODEL, driver.ID, driver.LOWEST, driver.TORQUE, driver.GOAL, (55, 1)]
    assert all(theirs[address].size == size for address, size in ours)
    assert dict(rustypot.Sts3215PyController.models())["STS3215"] == 777


@pytest.mark.realtime
def test_the_maker_s_library_completes_a_session(bench):
    sdk = pytest.importorskip("scservo_sdk")
    port = sdk.PortHandler(bench.path)
    assert port.openPort() and port.setBaudRate(1_000_000)
    client = sdk.sms_sts(port)

    heard = partial(heard_by, sdk.COMM_SUCCESS)
    assert heard(client.ping, 1) == (777, 0, 0)
    heard(client.unLockEprom, 1)
    assert heard(client.write2ByteTxRx, 1, sdk.SMS_STS_MAX_ANGLE_LIMIT_L, 3000) == (0, 0)
    heard(client.LockEprom, 1)
    assert bench.device.table.stored[11] | bench.device.table.stored[12] << 8 == 3000
    heard(client.write1ByteTxRx, 1, sdk.SMS_STS_TORQUE_ENABLE, 1)
    heard(client.WritePosEx, 1, 2300, 3000, 0)
    until(lambda: heard(client.ReadPos, 1)[0] == 2300)
    bench.device.fail(OVERHEATED)
    assert heard(client.ReadPos, 1)[2] == sdk.ERRBIT_OVERHEAT
    assert not bench.on  # it is in the unloading condition
    heard(client.write1ByteTxRx, 1, sdk.SMS_STS_TORQUE_ENABLE, 0)
    assert heard(client.read1ByteTxRx, 1, sdk.SMS_STS_TORQUE_ENABLE)[0] == 0
    port.closePort()
