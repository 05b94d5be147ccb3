"""The BNO085 in UART-RVC mode over a pseudo-terminal: packets, rates, faults, and which IMU."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, served
from support import until
from tailbeat.emulators.imu import Bno055, direction, up_of
from tailbeat.emulators.imu import serve as serve_bno055
from tailbeat.emulators.imu_rvc import Bno085, send, serve
from tailbeat.emulators.line import close_line, open_line
from tailbeat.files import BadInput
from tailbeat.robot import imu_rvc as driver
from tailbeat.robot import imus
from tailbeat.robot.imu import ImuFault
from tailbeat.robot.imu_rvc import Packet, connect, packets, slope
from tailbeat.robot.mounting import AXIS_VECTORS, Mounting, mounting_of, named
from tailbeat.robot.mounting import direction as pointing

pytestmark = pytest.mark.realtime

# The example of the BNO08X data sheet, 1.3.5.2.
EXAMPLE = bytes.fromhex("AAAADE010092FF25088DFEECFFD103000000E7")
MEANT = Packet(0xDE, (1, -110, 2085), (-371, -20, 977))


@dataclass
class Turning(Bno085):
    """A sensor that turns at `rate` [rad/s] by itself."""

    rate: float = 0.0
    began: float = field(default_factory=time.monotonic)

    def speak(self, now: float) -> bytes:
        self.turn(self.rate * (now - self.began), self.rate)
        return super().speak(now)


@pytest.fixture
def sensor() -> Turning:
    return Turning()


@pytest.fixture
def path(sensor) -> Iterator[str]:
    with served(serve, sensor) as (where, _):
        yield where


@pytest.fixture
def imu(path) -> Iterator[driver.Bno085]:
    opened = connect(path, deadline=PATIENT)
    yield opened
    opened.close()


def rates(imu: driver.Bno085, count: int) -> list[float]:
    """Rates of the readings that came; three in four must."""
    came = []
    for _ in range(count):
        found = imu.read()
        came += [found.rate] if found else []
        time.sleep(0.015)
    assert len(came) > 0.75 * count
    return came


# ---- bytes --------------------------------------------------------------------------------------


def test_the_data_sheet_s_example_is_read():
    assert packets(bytearray(EXAMPLE)) == ([MEANT], 0)


def test_packets_are_found_among_other_bytes_and_damaged_ones_are_left_out():
    damaged = EXAMPLE[:-1] + b"\x00"
    stream = bytearray(b"\x01\xaa" + EXAMPLE + damaged + b"\xaa" + EXAMPLE + EXAMPLE[:7])
    found, wrong = packets(stream)
    assert found == [MEANT, MEANT] and wrong >= 1
    assert stream == EXAMPLE[:7]  # the rest is kept for the next reading
    assert packets(stream) == ([], 0)
    stream += EXAMPLE[7:]
    assert packets(stream) == ([MEANT], 0) and not stream


def test_an_angle_that_cannot_be_is_no_packet():
    body = b"\x00" + (18_001).to_bytes(2, "little") + bytes(13)
    assert packets(bytearray(b"\xaa\xaa" + body + bytes([sum(body) % 256])))[0] == []


def test_every_way_of_cutting_the_stream_gives_the_same_packets():
    whole = b"".join(Bno085(index=250 + k).speak(0.0) for k in range(5))
    for cut in range(len(whole)):
        stream = bytearray(whole[:cut])
        first, _ = packets(stream)
        stream += whole[cut:]
        assert [one.index for one in first + packets(stream)[0]] == [251, 252, 253, 254, 255]


def test_a_sensor_that_nobody_reads_does_not_wait():
    """A pseudo-terminal takes about 4 kB."""
    line, sensor, began = open_line(), Bno085(), time.monotonic()
    for k in range(2000):
        send(line, sensor.speak(0.01 * k))
    assert time.monotonic() - began < 5.0
    close_line(line)


def test_a_slope_is_that_of_the_line():
    assert slope([(0.0, 1.0), (0.01, 1.02), (0.03, 1.06)]) == pytest.approx(2.0)


# ---- rates --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_the_rate_is_that_of_the_angle_over_half_turns(sensor, imu, rate):
    """4 s at 2 rad/s pass +-180 degrees."""
    sensor.rate = rate
    found = rates(imu, 160)
    assert sorted(found)[len(found) // 2] == pytest.approx(rate, abs=0.05)


def test_the_noise_at_rest_is_that_of_the_counts(imu):
    found = rates(imu, 60)
    assert 0.0 < max(map(abs, found)) < 0.05


def test_lost_packets_change_no_rate():
    """The times are the index's: of packets 0, 1, 4 the slope is the same as of 0, 1, 2."""
    sensor = driver.Bno085(port=None, mounting=Mounting())
    for index in (254, 255, 2):
        sensor._take(Packet(index, (100 * ((index + 2) % 256), 0, 0), (0, 0, index)))
    assert slope(sensor.recent) == pytest.approx(math.radians(100))
    sensor._take(Packet(2, (900, 0, 0), (0, 0, 0)))  # repeated
    assert len(sensor.recent) == 3
    sensor._take(Packet(2 + driver.GAP + 1, (9000, 0, 0), (0, 0, 0)))
    assert len(sensor.recent) == 1  # after a long gap the slope begins anew


def test_old_packets_are_dropped_and_not_taken_for_new_ones(sensor, imu):
    until(lambda: imu.port.in_waiting > driver.LATE)  # about 0.7 s; longer beside other programs
    sensor.rate = 1.0
    assert imu.read() is None
    assert imu.read() is None or not imu.stream
    found = rates(imu, 20)
    assert sorted(found)[10] == pytest.approx(1.0, abs=0.1)


# ---- faults -------------------------------------------------------------------------------------


def test_damaged_packets_are_counted_and_cost_a_reading_at_most(sensor, imu):
    sensor.faults.damaged = 3
    assert len(rates(imu, 30)) > 20 and imu.damaged == 3


def test_a_silent_sensor_costs_its_deadline_alone(sensor, imu):
    sensor.faults.mute, imu.deadline = 10**6, 0.02
    time.sleep(0.05)
    imu.read()
    began = time.monotonic()
    assert imu.read() is None and time.monotonic() - began < 0.2
    with pytest.raises(ImuFault, match="no packets"):
        imu.prepare()
    sensor.faults.mute = 0
    imu.deadline = PATIENT
    assert imu.healthy() and rates(imu, 5)


def test_a_spike_shows_and_a_frozen_sensor_is_told_from_a_still_one(sensor, imu):
    rates(imu, 2 * driver.FROZEN)

    def spiked() -> bool:
        """Where a busy machine loses the packets beside a spike, the slope hides it: once more."""
        sensor.faults.spike = 20.0
        return any(abs(found.rate) > 5.0 for _ in range(10) if (found := imu.read()))

    until(spiked)
    sensor.faults.frozen = True
    with pytest.raises(ImuFault, match="same numbers") as told:
        rates(imu, 4 * driver.FROZEN)
    assert told.value.kind == "frozen"
    sensor.faults.frozen = False
    imu.reopen()
    assert rates(imu, 5)


def test_a_pulled_cable_is_told(sensor):
    with served(serve, sensor) as (path, pull):
        imu = connect(path, deadline=PATIENT)
        pull()
        with pytest.raises(ImuFault) as told:
            imu.read()
        assert told.value.kind == "gone"
        with pytest.raises(ImuFault, match="check the cable"):
            imu.reopen()
        imu.close()


# ---- mounting -----------------------------------------------------------------------------------


@pytest.mark.parametrize("up", ["z", "-z"])
def test_upside_down_the_yaw_has_the_same_sign_and_gravity_tells_it(sensor, path, up):
    """The data sheet's order is yaw, pitch, roll: upside down is a roll of 180 degrees."""
    sensor.up = direction(up)
    imu = connect(path, Mounting(AXIS_VECTORS[up]), PATIENT)
    assert named(imu.up()) == up
    assert imu.last is not None and (abs(imu.last.angles[2]) > 17_900) == (up == "-z")
    sensor.rate = 1.0
    found = rates(imu, 30)
    assert sorted(found)[len(found) // 2] == pytest.approx(1.0, abs=0.05)
    imu.close()


@pytest.mark.parametrize("angles", [(0, 0, 0), (90, 0, 20), (180, 0, 0), (30, -50, 70),
                                    (0, 90, 0), (40, -90, 10), (-150, 89.9, 5)])  # fmt: skip
def test_any_rotation_gives_the_fish_s_rate(angles):
    """In packets as the data sheet has them, also where yaw and roll alone are not defined."""
    rotation = tuple(np.radians(angles).tolist())
    hardware = XW430.model_copy(update={"imu_rotation": rotation})
    sensor, mounting = Bno085(up=up_of(hardware)), mounting_of(hardware)
    headings = []
    for k in range(400):
        sensor.turn(0.02 * k, 2.0)
        sensor.due = None  # a packet for each call
        (packet,), _ = packets(bytearray(sensor.speak(0.01 * k)))
        yaw, pitch, roll = np.radians(np.array(packet.angles) / 100)
        headings.append(mounting.heading(yaw, pitch, roll))
        assert mounting.off(pointing(packet.accelerations)) < 0.02
    steps = np.diff(np.unwrap(headings))
    assert steps == pytest.approx(0.02, abs=0.001)


def test_a_turn_that_shows_in_the_roll_alone_is_seen():
    """With x straight up a sensor may say the same attitude by its yaw or by its roll."""
    mounting = Mounting(AXIS_VECTORS["x"], AXIS_VECTORS["y"])
    by_yaw = [mounting.heading(yaw, -math.pi / 2, 0.0) for yaw in (0.1, 0.4)]
    by_roll = [mounting.heading(0.0, -math.pi / 2, roll) for roll in (0.1, 0.4)]
    assert by_yaw[1] - by_yaw[0] == pytest.approx(0.3)
    assert by_roll[1] - by_roll[0] == pytest.approx(0.3)


# ---- which IMU ----------------------------------------------------------------------------------


def test_which_of_both_is_at_a_port_is_found_out(sensor, path):
    found = imus.connect(path, Mounting(), PATIENT)
    assert found.name == "BNO085" and found.read() is not None
    found.close()
    other = Bno055(rates=(0.0, 0.5, 0.0))
    with served(serve_bno055, other) as (place, _):
        found = imus.connect(place, Mounting(AXIS_VECTORS["-y"]), PATIENT)
        assert found.name == "BNO055"
        found.prepare()
        reading = found.read()
        assert reading is not None and reading.rate == pytest.approx(-0.5, abs=0.05)
        found.close()


def test_a_port_with_neither_is_one_sentence(sensor, path, tmp_path):
    sensor.faults.mute = 10**9
    with pytest.raises(BadInput, match="neither a BNO055 nor a BNO085 is at this port") as told:
        imus.connect(path, Mounting(), 0.02)
    assert str(told.value).startswith(path) and str(told.value).count(". ") == 0
    with pytest.raises(BadInput, match="give the IMU's port"):
        imus.connect(str(tmp_path / "none"), Mounting())


# ---- a client by other people -------------------------------------------------------------------


def test_adafruit_s_library_reads_the_emulated_sensor(sensor, path):
    """Its heading is yaw, pitch, roll [deg] and accelerations [m/s^2]."""
    adafruit = pytest.importorskip("adafruit_bno08x_rvc")
    import serial

    sensor.rate, sensor.began, sensor.up = 0.0, 0.0, direction("-z")
    sensor.speak = lambda now: (sensor.turn(2.0, 0.0), Bno085.speak(sensor, now))[1]
    with serial.Serial(path, 115_200, timeout=1) as port:
        client = adafruit.BNO08x_RVC(port)
        for _ in range(500):  # until the packets from before are read, of a sensor not yet turned
            if client.heading[0]:
                break
        for _ in range(10):
            yaw, pitch, roll, x, y, z = client.heading
            assert yaw == pytest.approx(math.degrees(2.0), abs=0.05)
            assert pitch == pytest.approx(0.0, abs=0.05) and abs(roll) == pytest.approx(180, abs=1)
            assert (x, y) == pytest.approx((0.0, 0.0), abs=0.2)
            assert z == pytest.approx(-9.807, abs=0.2)


def test_adafruit_s_library_reads_the_same_packets_as_the_driver():
    adafruit = pytest.importorskip("adafruit_bno08x_rvc")
    sensor, now = Turning(rate=1.7), 0.0
    for k in range(600):  # the index passes 255 and the yaw passes 180 degrees
        now = sensor.began + 0.01 * k
        sent = sensor.speak(now)
        if not sent:
            continue
        (ours,), damaged = packets(bytearray(sent))
        theirs = adafruit.BNO08x_RVC._parse_frame(sent[2:])
        assert theirs is not None and not damaged
        assert [100 * one for one in theirs[:3]] == pytest.approx(ours.angles)
        assert [one / 0.0098067 for one in theirs[3:]] == pytest.approx(ours.accelerations)
