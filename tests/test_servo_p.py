"""Dynamixels of the P series: another control table, and pulses of each model's own gear. The
tables are the maker's; its library and our driver complete a session over real bytes."""

import math
from pathlib import Path

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, servo_bench
from support import tailbeat, until
from tailbeat.emulators.servo_p import P_MODELS
from tailbeat.emulators.servo_table import ACCESS, LIMIT
from tailbeat.emulators.servo_table import Table as EmulatedTable
from tailbeat.files import BadInput
from tailbeat.fish.description import Hardware
from tailbeat.fish.store import load_fish
from tailbeat.robot import dynamixel_tables as tables
from tailbeat.robot import prepare
from tailbeat.robot.doctor_devices import check_servo
from tailbeat.robot.dynamixel_tables import P_STEPS, table_of
from tailbeat.robot.findings import BAD
from tailbeat.robot.servo import ServoFault, connect, on_port
from tailbeat.robot.wire import open_port

PM42 = Hardware(
    family="dynamixel-p", make="ROBOTIS", model="PM42-010-S260-R", number=2100, supply=24.0,
    supply_range=(15.0, 35.0), current_unit=0.001, current_limit=0.6, temperature_limit=80.0,
    gain=32,
)  # fmt: skip
FISH = load_fish("pulley-fish").model_copy(update={"hardware": PM42})
NAMES = {
    "torque": "Torque Enable", "return_level": "Status Return Level", "gain": "Position P Gain",
    "hardware_error": "Hardware Error Status", "bus_watchdog": "Bus Watchdog",
    "profile_acceleration": "Profile Acceleration", "profile_velocity": "Profile Velocity",
    "goal": "Goal Position", "moving": "Moving", "present_current": "Present Current",
    "present_velocity": "Present Velocity", "present_position": "Present Position",
    "present_voltage": "Present Input Voltage", "temperature": "Present Temperature",
}  # fmt: skip
STORED = {
    "MODEL": "Model Number", "FIRMWARE": "Firmware Version", "ID": "ID", "BAUD": "Baud Rate",
    "RETURN_DELAY": "Return Delay Time", "DRIVE_MODE": "Drive Mode", "HOMING": "Homing Offset",
    "OPERATING_MODE": "Operating Mode", "HIGHEST": "Max Position Limit",
    "LOWEST": "Min Position Limit", "SHUTDOWN": "Shutdown",
}  # fmt: skip


# ---- the tables ---------------------------------------------------------------------------------


def by_the_maker(number: int) -> tuple[dict[str, tuple[int, int]], dict[str, str]]:
    """Registers and other numbers of a model in the maker's library."""
    sdk = pytest.importorskip("dynamixel_easy_sdk")
    folder = Path(sdk.__file__).parent / "control_table"
    listed = (folder / "dynamixel.model").read_text("utf-8").split()
    unlisted = {1280: "xw430_t200.model"}
    name = unlisted.get(number) or listed[listed.index(str(number)) + 1]
    rows = [line.split("\t") for line in (folder / name).read_text("utf-8").splitlines()]
    registers = {row[2]: (int(row[0]), int(row[1])) for row in rows if row[0].isdecimal()}
    return registers, {row[0]: row[1] for row in rows if len(row) in (2, 4)}


@pytest.mark.parametrize("number", [30, 1020, 1060, 1090, 1120, 1170, 1200, 1240, 1280, *P_STEPS])
def test_registers_and_units_are_those_of_the_maker_s_tables(number):
    registers, numbers = by_the_maker(number)
    if "Present Load" in registers:  # of models that measure no current, at the same address
        registers["Present Current"] = registers["Present Load"]
    registers.setdefault("Bus Watchdog", (98, 1))  # not listed of an MX-28
    table = table_of(number)
    assert {ours: getattr(table, ours) for ours in NAMES} == {
        ours: registers[theirs] for ours, theirs in NAMES.items()
    }
    assert {ours: getattr(tables, ours) for ours in STORED} == {
        ours: registers[theirs] for ours, theirs in STORED.items()
    }
    assert table.centre == int(numbers["value_of_zero_radian_position"])
    half = int(numbers["value_of_max_radian_position"]) - table.centre
    assert table.steps / 2 in (half, half + 1)
    assert table.velocity == pytest.approx(float(numbers["Present Velocity"]), rel=1e-3)


def test_the_emulated_models_turn_by_as_many_pulses():
    assert {number: model.steps for number, model in P_MODELS.items()} == P_STEPS


# ---- sessions -----------------------------------------------------------------------------------


@pytest.mark.realtime
def test_the_maker_s_library_completes_a_session(monkeypatch):
    """Addresses and lengths are read from the library's own table."""
    sdk = pytest.importorskip("dynamixel_sdk")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 100)  # ms; the emulator is a thread
    registers, _ = by_the_maker(2100)
    with servo_bench(PM42) as bench:
        port, packets = sdk.PortHandler(bench.path), sdk.PacketHandler(2.0)
        assert port.openPort()

        def read(name: str) -> int:
            address, size = registers[name]
            value, heard, error = getattr(packets, f"read{size}ByteTxRx")(port, 1, address)
            assert (heard, error) == (sdk.COMM_SUCCESS, 0), name
            return int(value)

        def write(name: str, value: int) -> int:
            address, size = registers[name]
            heard, error = getattr(packets, f"write{size}ByteTxRx")(port, 1, address, value)
            assert heard == sdk.COMM_SUCCESS, name
            return int(error)

        assert packets.ping(port, 1) == (2100, 0, 0)
        for name, value in (("Operating Mode", 3), ("Return Delay Time", 0)):
            assert write(name, value) == 0
        assert write("Min Position Limit", -100_000) == write("Max Position Limit", 100_000) == 0
        assert write("Torque Enable", 1) == 0 and bench.on
        assert write("Goal Position", 100_001) == LIMIT
        assert write("Goal Position", 50_000) == 0
        until(lambda: abs(read("Present Position") - 50_000) < 20)
        assert bench.device.shaft.angle == pytest.approx(50_000 / 526_374 * math.tau, abs=1e-3)
        assert read("Present Input Voltage") == 240 and read("Present Temperature") == 30
        assert packets.read1ByteTxRx(port, 1, 64)[2] == ACCESS  # where an X servo has its torque
        assert write("Torque Enable", 0) == 0 and bench.device.get(64) == 0
        port.closePort()


@pytest.mark.realtime
def test_the_driver_arms_follows_and_reads_in_si_units():
    with servo_bench(PM42) as bench:
        servo = connect(bench.path, PM42, deadline=PATIENT)
        servo.prepare(-1.4, 1.4)
        assert servo.arm(2.0) == pytest.approx(0.0, abs=1e-4) and bench.on
        sent = servo.write(-0.5)
        assert sent == pytest.approx(-0.5, abs=1e-5)
        until(lambda: abs(servo.read().angle - sent) < 1e-3)
        bench.device.faults.frozen = True
        for address, value in ((126, 700), (128, -300)):
            bench.device.put(address, value)
        state = servo.read()
        assert (state.current, state.voltage, state.temperature) == pytest.approx((0.7, 24.0, 30.0))
        assert state.velocity == pytest.approx(-3 * math.tau / 60)
        with pytest.raises(ServoFault, match="limit"):
            servo.write(1.5)
        bench.device.fail(1)
        assert servo.hardware_errors() == ["hall sensor"] and not servo.is_on()
        servo.close()


@pytest.mark.realtime
def test_what_its_memory_holds_is_not_written_at_every_arming(monkeypatch):
    """The lower limit is negative, and its register was compared as if it had no sign."""
    with servo_bench(PM42) as bench:
        servo = connect(bench.path, PM42, deadline=PATIENT)
        servo.prepare(-1.4, 1.4)
        write, written = bench.device.table.write, list[int]()

        def noted(at: int, data: bytes) -> int:
            written.append(at)
            return int(write(at, data))

        monkeypatch.setattr(bench.device.table, "write", noted)
        servo.prepare(-1.4, 1.4)
        assert bench.device.get(52, True) < 0
        assert written and not {9, 11, 48, 52} & set(written)
        servo.prepare(-1.3, 1.4)
        assert 52 in written and 48 not in written
        servo.close()


@pytest.mark.realtime
def test_its_own_watchdog_stops_it_and_release_lets_it_go():
    with servo_bench(PM42) as bench:
        servo = connect(bench.path, PM42, deadline=PATIENT)
        servo.prepare(-1.4, 1.4)
        servo.arm(0.06)
        until(lambda: bench.device.get(98) == 0xFF)
        assert servo.stopped_itself()
        with pytest.raises(ServoFault, match="bus watchdog"):
            servo.write(0.2)
        servo.release(2.0)
        assert servo.write(0.2) == pytest.approx(0.2, abs=1e-5)
        servo.close()


@pytest.mark.realtime
def test_prepare_and_doctor_use_its_table(monkeypatch):
    monkeypatch.setitem(prepare.LISTEN, "dynamixel-p", PATIENT)
    with servo_bench(PM42) as bench:
        for address, value in {7: 7, 8: 1, 10: 1, 20: 300, 63: 0, 68: 1, 112: 40}.items():
            bench.device.put(address, value)
        looked = prepare.look(bench.path, FISH)
        assert looked.found == prepare.Found(57_600, 7, 2100)
        changes = prepare.write(bench.path, FISH, looked)
        assert len(changes) == len(looked.wrong) and all(one.done for one in changes)
        ends = [bench.device.get(address, True) for address in (52, 48)]
        assert ends == [-116_972, 116_972]  # 80 degrees
        servo = connect(bench.path, PM42, deadline=PATIENT)
        assert not [one for one in check_servo(servo, PM42) if one.verdict == BAD]
        servo.close()


# ---- torque off, whatever the series ------------------------------------------------------------


@pytest.mark.realtime
def test_torque_goes_off_without_knowing_the_series():
    with servo_bench(PM42) as bench:
        bench.armed()
        done = tailbeat("torque-off", "--servo", bench.path)
        assert done.returncode == 0 and not bench.on, done.stderr


def held(table: EmulatedTable, address: int, size: int) -> bytes:
    """The model number, and 0 elsewhere."""
    return bytes(table.bytes[:2]) if address == 0 else bytes(size)


@pytest.mark.realtime
def test_another_series_does_not_confirm_that_torque_is_off(monkeypatch):
    """A servo may answer for a register that it does not have, and say 0."""
    with servo_bench(PM42) as bench:
        bench.armed()
        at = bench.device.table
        monkeypatch.setattr(at, "read", lambda address, size: (0, held(at, address, size)))
        monkeypatch.setattr(at, "write", lambda address, data: 0)
        port = open_port(bench.path, 1_000_000, PATIENT)
        with pytest.raises(ServoFault, match="another series"):
            on_port(port, "dynamixel-x", 1, PATIENT).torque_off()
        port.close()


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fish", "answers", "said"),
    [
        (XW430, PM42, 'write family = "dynamixel-p"'),
        (PM42, XW430, 'write family = "dynamixel-x"'),
        (PM42, PM42.model_copy(update={"number": 2130}), "how many counts"),
        (PM42, PM42.model_copy(update={"number": 2000}), "2000 answers, the fish's PM42"),
    ],
)
def test_another_servo_than_the_fish_s_is_refused(fish, answers, said):
    with servo_bench(answers) as bench, pytest.raises(BadInput, match=said):
        connect(bench.path, fish, deadline=PATIENT)
