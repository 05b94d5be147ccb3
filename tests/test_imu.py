"""The IMU's driver and the emulated IMU over a pseudo-terminal, and what goes wrong there."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import served
from tailbeat.emulators.imu import Bno055, serve
from tailbeat.files import BadInput
from tailbeat.robot import imu as driver
from tailbeat.robot.imu import Imu, ImuFault, connect
from tailbeat.robot.mounting import AXIS_VECTORS, Mounting

pytestmark = pytest.mark.realtime

PATIENT = 0.25  # s: the emulator is a thread of this process and waits for the interpreter


@dataclass
class Bench:
    """An emulated sensor on a line."""

    sensor: Bno055
    path: str
    pull: Callable[[], None]


@pytest.fixture
def bench() -> Iterator[Bench]:
    sensor = Bno055()
    with served(serve, sensor) as (path, pull):
        yield Bench(sensor, path, pull)


@pytest.fixture
def imu(bench) -> Iterator[Imu]:
    opened = connect(bench.path, deadline=PATIENT)
    opened.prepare()
    yield opened
    opened.close()


def rate_of(imu: Imu) -> float:
    found = imu.read()
    assert found is not None
    return found.rate


def test_the_bytes_are_the_data_sheet_s():
    """BST-BNO055-DS000, 4.7: read AA 01 register length -> BB length data; write -> EE 01."""
    sensor = Bno055()
    assert sensor.answer(bytes.fromhex("AA010001")) == bytes.fromhex("BB01A0")
    assert sensor.answer(bytes.fromhex("AA003D0105")) == bytes.fromhex("EE01")
    assert sensor.answer(bytes.fromhex("AA000001FF")) == bytes.fromhex("EE05")
    assert sensor.answer(b"\x55\x01\x00\x01") == bytes.fromhex("EE06")
    assert sensor.answer(bytes.fromhex("AA016010")) == bytes.fromhex("EE04")


def test_rates_come_in_radians_about_the_fish_s_own_axis(bench):
    for up, axis, sign in (("z", 2, 1), ("-z", 2, -1), ("x", 0, 1)):
        opened = connect(bench.path, Mounting(AXIS_VECTORS[up]), PATIENT)
        opened.prepare()
        assert opened.healthy()
        turning = [0.1, 0.2, 0.3]
        turning[axis] = 1.5
        bench.sensor.rates = (turning[0], turning[1], turning[2])
        found = [rate_of(opened) for _ in range(40)]
        assert np.mean(found) == pytest.approx(1.5 * sign, abs=0.005)
        assert 0.001 < np.std(found) < 0.02
        opened.close()


def test_a_busy_sensor_costs_a_reading_and_no_more(bench, imu):
    bench.sensor.faults.busy = 3
    assert [imu.read() is None for _ in range(4)] == [True, True, True, False]
    assert imu.over_runs == 3 and imu.missed == 3


def test_a_silent_sensor_costs_its_deadline_alone(bench, imu):
    bench.sensor.faults.mute, imu.deadline, took = 5, 0.02, []
    for _ in range(5):
        began = time.monotonic()
        assert imu.read() is None
        took.append(time.monotonic() - began)
    assert min(took) < 0.2  # a busy machine delays some of them
    imu.deadline = PATIENT
    assert imu.read() is not None


def test_rates_no_gyroscope_can_have_are_dropped(bench, imu):
    bench.sensor.faults.spike = 35.7  # beyond 2000 deg/s
    assert imu.read() is None and imu.missed == 1
    assert imu.read() is not None


def test_a_frozen_sensor_is_told_from_a_still_one(bench, imu):
    for _ in range(2 * driver.FROZEN):
        assert imu.read() is not None
    bench.sensor.faults.frozen = True
    with pytest.raises(ImuFault, match="same numbers"):
        for _ in range(2 * driver.FROZEN):
            imu.read()


def test_a_pulled_cable_is_told(bench, imu):
    bench.pull()
    with pytest.raises(ImuFault) as told:
        for _ in range(20):
            imu.read()
    assert told.value.kind == "gone"
    imu.close()


def test_a_port_that_is_someone_else_s_is_refused(bench, tmp_path):
    with pytest.raises(BadInput, match="give the IMU's port"):
        connect(str(tmp_path / "nothing"))
    bench.sensor.faults.mute = 5
    with pytest.raises(BadInput, match="no BNO055 answers"):
        connect(bench.path, deadline=0.02)
    bench.sensor.table[0] = 0x83
    with pytest.raises(BadInput, match="chip 0x83 answers, a BNO055 has 0xa0"):
        connect(bench.path, deadline=PATIENT)


# ---- the second page, and a client by other people ----------------------------------------------


def test_a_sensor_that_another_program_left_on_page_1_is_taken_over(bench):
    bench.sensor.table[0x07] = 1
    assert bench.sensor.answer(bytes.fromhex("AA010001")) == bytes.fromhex("BB0100")  # no chip id
    opened = connect(bench.path, deadline=PATIENT)
    opened.prepare()
    bench.sensor.rates = (0.0, 0.0, 0.5)
    assert rate_of(opened) == pytest.approx(0.5, abs=0.05)
    opened.close()


def test_page_1_has_its_own_registers_and_a_reset_is_silent():
    sensor = Bno055()
    assert sensor.answer(bytes.fromhex("AA00080100")) == bytes.fromhex("EE05")  # page 0: a reading
    assert sensor.answer(bytes.fromhex("AA00070101")) == bytes.fromhex("EE01")
    assert sensor.answer(bytes.fromhex("AA010803")) == bytes.fromhex("BB030D0B38")  # data sheet
    assert sensor.answer(bytes.fromhex("AA00080105")) == bytes.fromhex("EE01")
    assert sensor.answer(bytes.fromhex("AA003D0105")) == bytes.fromhex("EE05")  # mode: page 0
    assert sensor.answer(bytes.fromhex("AA00070100")) == bytes.fromhex("EE01")
    assert sensor.answer(bytes.fromhex("AA003F0120")) == b""
    assert sensor.answer(bytes.fromhex("AA010001")) == b""
    sensor.quiet_until = 0.0
    assert sensor.second[0x08] == 0x0D


def test_the_driver_of_adafruit_completes_a_session(bench):
    """It resets the sensor, sets ranges on page 1, and reads in a fusion mode."""
    adafruit = pytest.importorskip("adafruit_bno055")
    import serial

    with serial.Serial(bench.path, 115_200, timeout=1) as port:
        for _ in range(5):  # it waits a tenth of a second for a reply
            try:
                client = adafruit.BNO055_UART(port)
                break
            except (OSError, RuntimeError):
                port.reset_input_buffer()
        assert client.mode == adafruit.NDOF_MODE
        bench.sensor.rates = (0.0, 0.0, 1.0)
        _, _, rate = client.gyro
        assert rate == pytest.approx(1.0, abs=0.05)
