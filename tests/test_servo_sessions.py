"""Other people's clients complete a session with the emulated Dynamixels, model by model, and each
model has its own limits."""

import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, bought, servo_bench
from support import complaint, tailbeat, until
from tailbeat.emulators.servo_models import MODELS
from tailbeat.emulators.servo_table import ACCESS, RANGE, Table
from tailbeat.files import BadInput
from tailbeat.fish.catalogue import profiles
from tailbeat.link.datagrams import make_key
from tailbeat.robot.servo import connect

CLIENTS = {"xl330": "Xl330PyController", "xl430": "Xl430PyController", "xm430": "Xl430PyController",
           "xm540": "Xl430PyController", "2xl430": "Xl430PyController"}  # fmt: skip
DYNAMIXELS = [one for one in profiles().values() if one.family == "dynamixel-x"]


# ---- sessions -----------------------------------------------------------------------------------


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["xl330", "xl430", "xm540"])
def test_the_maker_s_library_completes_a_session(name, monkeypatch):
    sdk = pytest.importorskip("dynamixel_sdk")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 100)  # ms; the emulator is a thread
    hardware = bought(name)
    with servo_bench(hardware) as bench:
        port, packets = sdk.PortHandler(bench.path), sdk.PacketHandler(2.0)
        assert port.openPort()

        def heard(call: Callable[..., tuple[int, ...]], *words: int) -> tuple[int, ...]:
            """On a busy machine even that is too short: it asks again."""
            for _ in range(20):
                answer = call(port, *words)
                if answer[-2] == sdk.COMM_SUCCESS:
                    return answer
                time.sleep(0.05)
                port.ser.reset_input_buffer()  # codespell:ignore ser
            raise AssertionError(answer)

        assert heard(packets.ping, 1) == (hardware.number, 0, 0)
        for address, value in ((11, 3), (9, 0)):  # position mode, no return delay
            assert heard(packets.write1ByteTxRx, 1, address, value) == (0, 0)
        for address, value in ((52, 1000), (48, 3000)):
            assert heard(packets.write4ByteTxRx, 1, address, value) == (0, 0)
        assert heard(packets.write1ByteTxRx, 1, 64, 1) == (0, 0) and bench.on
        assert heard(packets.write4ByteTxRx, 1, 116, 3500) == (0, sdk.ERRNUM_DATA_LIMIT)
        assert heard(packets.write4ByteTxRx, 1, 116, 2300) == (0, 0)
        until(lambda: heard(packets.read4ByteTxRx, 1, 132) == (2300, 0, 0))
        assert heard(packets.read2ByteTxRx, 1, 144)[0] == round(10 * hardware.supply)
        assert heard(packets.write1ByteTxRx, 1, 64, 0) == (0, 0) and bench.device.get(64) == 0
        assert heard(packets.read1ByteTxRx, 1, 64) == (0, 0, 0)
        port.closePort()


def patiently(call: Callable[..., Any], *words: object) -> Any:
    """Of a client that gives up after its own time: on a busy machine it is asked again."""
    for _ in range(5):
        try:
            return call(*words)
        except RuntimeError as error:
            said = error
    raise said


@pytest.mark.realtime
@pytest.mark.parametrize("name", CLIENTS)
def test_a_client_by_other_people_completes_a_session(name):
    rustypot = pytest.importorskip("rustypot")
    hardware = bought(name)
    with servo_bench(hardware) as bench:
        client = getattr(rustypot, CLIENTS[name])(bench.path, 1_000_000, 0.5)
        assert hardware.number in client.models().values()
        assert patiently(client.ping, 1)
        assert patiently(client.read_model_number, 1) == [hardware.number]
        patiently(client.write_operating_mode, 1, 3)
        patiently(client.write_register, 1, "min_position_limit", 1000)
        patiently(client.write_register, 1, "torque_enable", 1)
        patiently(client.write_register, 1, "goal_position", 2300)
        until(lambda: patiently(client.read_register, 1, "present_position") == 2300)
        until(lambda: patiently(client.sync_read_register, [1], "present_position") == [2300])
        assert bench.device.get(64) == 1 and bench.device.get(52) == 1000
        patiently(client.write_register, 1, "torque_enable", 0)
        assert bench.device.get(64) == 0
        client.close()


# ---- each model its own -------------------------------------------------------------------------


@pytest.mark.parametrize("profile", DYNAMIXELS, ids=lambda one: one.name)
def test_a_model_has_its_own_limits_units_and_modes(profile):
    hardware = bought(profile.name)
    table, model = Table(hardware), MODELS[hardware.number]
    assert table.get(0) == hardware.number and table.get(84) == hardware.gain
    assert (table.get(34), table.get(32)) == tuple(round(10 * v) for v in hardware.supply_range)
    assert table.get(31) == hardware.temperature_limit and table.get(44) == model.velocity
    measures = profile.current_ma > 0
    assert bool(model.current) == measures == (38 in table.registers)
    assert table.write(11, b"\x05") == (0 if measures else RANGE)  # current-based position
    assert table.write(102, b"\x01\x00") == (0 if measures else ACCESS)
    assert hardware.current_unit == pytest.approx(
        profile.current_ma / 1000 if measures else profile.stall_a / 1000
    )


def test_models_differ():
    tables = {name: Table(bought(name)) for name in ("xl330", "xl430", "xm430", "xw430")}
    assert [tables[n].get(44) for n in tables] == [445, 265, 200, 235]
    assert [tables[n].get(63) for n in tables] == [53, 52, 52, 52]
    assert tables["xl330"].write(32, (120).to_bytes(2, "little")) == RANGE  # 12 V
    assert tables["xm430"].write(38, (1194).to_bytes(2, "little")) == RANGE


# ---- which models are driven --------------------------------------------------------------------


@pytest.mark.realtime
def test_another_model_of_the_x_series_is_driven_if_the_fish_names_it():
    xh430 = XW430.model_copy(update={"model": "XH430-W350-R", "number": 1000})
    with servo_bench(xh430) as bench:
        servo = connect(bench.path, xh430, deadline=PATIENT)
        servo.prepare(-1.0, 1.0)
        servo.arm(2.5)
        assert bench.on
        servo.close()


@pytest.mark.realtime
@pytest.mark.parametrize(("number", "series"), [(350, "XL-320"), (4000, "Y s")])
def test_a_servo_with_other_addresses_is_refused_even_if_the_fish_names_it(number, series):
    other = XW430.model_copy(update={"number": number})
    with (
        servo_bench(other) as bench,
        pytest.raises(BadInput, match=rf"{series}.*tailbeat does not support it"),
    ):
        connect(bench.path, other, deadline=PATIENT)


# ---- a servo that answers no writes -------------------------------------------------------------


@pytest.mark.realtime
@pytest.mark.parametrize("level", [0, 1])
def test_a_drive_names_a_servo_that_answers_no_writes(tmp_path, level):
    make_key(tmp_path / "fish.key")
    with servo_bench() as bench:
        bench.device.put(68, level)
        said = complaint(
            "drive", "pulley-fish-pool-generator", "--servo", bench.path, "--imu", bench.path,
            "--listen", "127.0.0.1:0", "--station", "127.0.0.1:9", "--key", tmp_path / "fish.key",
            "--log", tmp_path / "a.mcap",
        )  # fmt: skip
    assert f"status return level (register 68) is {level}" in said
    assert f"tailbeat prepare --servo {bench.path}" in said and "no reply" not in said


@pytest.mark.realtime
def test_torque_goes_off_although_the_write_is_not_answered():
    with servo_bench() as bench:
        bench.armed()
        bench.device.put(68, 1)
        done = tailbeat("torque-off", "--servo", bench.path)
        assert done.returncode == 0 and not bench.on, done.stderr
