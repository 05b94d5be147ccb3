"""Mounting, both IMUs and none in the emulated rig: which yaw rate the robot's loop sees."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from lines import PATIENT, XW430, served
from support import complaint as complaint_of
from support import tailbeat, tailbeat_process
from tailbeat.emulators import rig as bench
from tailbeat.emulators.imu import Bno055, direction, up_of
from tailbeat.emulators.imu import serve as serve_bno055
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Hardware
from tailbeat.fish.store import fish_path, load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.status import State
from tailbeat.robot import doctor, doctor_devices, imus, session
from tailbeat.robot.devices import Devices
from tailbeat.robot.findings import BAD, OK, WARN
from tailbeat.robot.loop import Loop
from tailbeat.robot.mounting import AXIS_VECTORS, Mounting, mounting_of, named
from tailbeat.robot.poses import Poses
from tailbeat.robot.sensors import CameraYaw
from tailbeat.robot.servo import connect as connect_servo
from test_loop import KEY, POLICY, WIDE
from test_loop import Bench as LoopBench
from test_poses import heard

pytestmark = pytest.mark.realtime("robot")


def mounted(up: str) -> Hardware:
    return XW430.model_copy(update={"imu_up": up})


def turned(*degrees: float) -> Hardware:
    """The IMU's roll, pitch and yaw in the fish."""
    return XW430.model_copy(update={"imu_rotation": tuple(np.radians(degrees).tolist())})


def fish_with(hardware: Hardware) -> Fish:
    return load_fish("pulley-fish").model_copy(update={"hardware": hardware})


# ---- the fish's file ----------------------------------------------------------------------------


def test_the_mounting_stands_in_the_fish_s_file_and_is_checked(tmp_path):
    text = fish_path("pulley-fish").read_text("utf-8")
    assert mounting_of(load_fish("pulley-fish").hardware or XW430) == Mounting()
    for up in ("-z", "x", "-y"):
        path = tmp_path / f"{up}.toml"
        path.write_text(text.replace("[hardware]", f'[hardware]\nimu_up = "{up}"\n#'))
        hardware = load_fish(path).hardware
        assert hardware is not None
        assert mounting_of(hardware).up == AXIS_VECTORS[up] and str(mounting_of(hardware)) == up
    (tmp_path / "odd.toml").write_text(text.replace("[hardware]", '[hardware]\nimu_up = "up"\n#'))
    done = tailbeat("show", tmp_path / "odd.toml")
    assert done.returncode == 2
    assert "hardware.imu_up = 'up'" in done.stderr and "'-z'" in done.stderr


def test_any_rotation_may_stand_in_the_fish_s_file(tmp_path):
    text = fish_path("pulley-fish").read_text("utf-8")
    path, line = tmp_path / "own.toml", "[hardware]\nimu_rotation = "
    path.write_text(text.replace("[hardware]", f'{line}"30 0 90 deg"'))
    hardware = load_fish(path).hardware
    assert hardware is not None and str(mounting_of(hardware)) == "0.00 0.50 0.87"
    assert mounting_of(hardware).ahead == pytest.approx((0, -math.cos(math.pi / 6), 0.5))
    again = Hardware.model_validate(hardware.model_dump())  # as a policy carries it
    assert again == hardware
    for value, complaint in {
        '"30 0 deg"': "hardware.imu_rotation",
        '"30 0 1 2 deg"': "hardware.imu_rotation",
        '"30 0 90"': "unit '' is not one of rad, deg",
        '"0 0 0 deg"\nimu_up = "x"': "imu_up and imu_rotation both say",
        "[nan, 0, 0]": "hardware.imu_rotation",
    }.items():
        path.write_text(text.replace("[hardware]", line + value))
        said = complaint_of("show", path)
        assert complaint in said, (value, said)


ROTATIONS = [(0, 0, 0), (0, 0, 130), (180, 0, 0), (90, 0, 0), (0, 90, 0), (25, -40, 70)]


@pytest.mark.parametrize("angles", ROTATIONS)
def test_a_bno055_at_any_rotation_gives_the_fish_s_rate(angles):
    hardware = turned(*angles)
    sensor = Bno055(up=up_of(hardware))
    sensor.turn(0.3, 1.5)
    with served(serve_bno055, sensor) as (path, _):
        imu = imus.connect(path, mounting_of(hardware), PATIENT)
        imu.prepare()
        reading = imu.read()
        assert reading is not None and reading.rate == pytest.approx(1.5, abs=0.05)
        assert mounting_of(hardware).off(imu.up()) < 0.01
        imu.close()


def test_the_emulator_and_the_driver_turn_alike():
    """As scipy has the rotation: about the fish's own axes x, y, z."""
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-180, 180, (50, 3)):
        fish_from_sensor = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        mounting = mounting_of(turned(*angles))
        assert mounting.ahead == pytest.approx(fish_from_sensor[0])
        assert mounting.up == pytest.approx(fish_from_sensor[2])
        assert up_of(turned(*angles)) == pytest.approx(fish_from_sensor[2])


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_a_bno055_of_any_mounting_gives_the_fish_s_rate_and_the_wrong_one_does_not(up):
    sensor = Bno055(up=direction(up))
    sensor.turn(0.3, 1.5)
    with served(serve_bno055, sensor) as (path, _):
        for told, wanted in ((up, 1.5), (up[1:] if up[0] == "-" else f"-{up}", -1.5)):
            imu = imus.connect(path, mounting_of(mounted(told)), PATIENT)
            imu.prepare()
            reading = imu.read()
            assert reading is not None and reading.rate == pytest.approx(wanted, abs=0.05)
            assert named(imu.up()) == up
            imu.close()


def test_the_doctor_compares_the_mounting_with_gravity():
    sensor = Bno055(up=direction("-z"))
    with served(serve_bno055, sensor) as (path, _):
        for told, up, verdict in (("-z", "-z", OK), ("z", "-z", BAD), ("z", "tilted", WARN)):
            tilted = (0.6, 0.6, 0.5)
            sensor.up = tilted if up == "tilted" else direction(up)
            imu, _ = doctor_devices.find_imu(path, mounted(told), PATIENT)
            assert imu is not None
            found = {one.name: one for one in doctor_devices.check_imu(imu, mounted(told))}
            imu.close()
            assert found["IMU mounting"].verdict == verdict, found["IMU mounting"]


def test_a_drive_refuses_an_imu_that_the_doctor_calls_bad():
    sensor = Bno055(up=direction("-z"))
    with served(serve_bno055, sensor) as (path, _):
        imu = imus.connect(path, Mounting(), PATIENT)
        with pytest.raises(BadInput, match="IMU mounting is -z is up by gravity, z by the fish's"):
            session._prepare(imu, path, mounted("z"))
        session._prepare(imu, path, mounted("-z"))
        imu.close()


# ---- the loop -----------------------------------------------------------------------------------


@contextmanager
def looped(described: Fish, kind: str, told: Hardware | None) -> Iterator[LoopBench]:
    """A loop on a rig with the IMU `kind`. `told` is the hardware that the loop knows; None: it has
    no IMU."""
    heard_at = link.bind("127.0.0.1", 0)
    made = bench.open_rig(described, KEY, heard_at.getsockname(), (1.5, 0.5), imu=kind)
    made.shaft.advance(0.0, 0.01)
    assert made.shaft.pose.shape == (3,)
    ended = threading.Event()
    thread = threading.Thread(target=bench.serve, args=(made, ended.is_set), daemon=True)
    thread.start()
    servo = connect_servo(made.ports[0], XW430, deadline=PATIENT)
    imu = imus.connect(made.ports[1], mounting_of(told), PATIENT) if told else None
    if imu is not None:
        imu.prepare()
    station = made.station.socket.getsockname()
    devices = Devices(servo, imu, link.Receiver(KEY, (5.5, 2.7)), heard_at, station)
    rows: list[dict[str, Any]] = []
    yield LoopBench(
        Loop(POLICY, devices, rows.append, WIDE, sign_test=False), made, ended.set, rows
    )
    ended.set()
    thread.join(5)
    servo.close()
    if imu is not None:
        imu.close()
    bench.close_rig(made)
    heard_at.close()


def likeness(one: LoopBench, until: float = 4.0) -> float:
    """Correlation of the loop's yaw rates with the plant's, while it swims."""
    pairs: list[tuple[float, float]] = []
    one.swim()
    end = time.monotonic() + until

    def over() -> bool:
        pairs.append((one.loop.sensors.yaw.rate, float(one.rig.shaft.state.v[0, 2])))
        return time.monotonic() > end

    one.ticks(over)
    ours, plants = np.array(pairs[20:]).T
    assert plants.std() > 0.1, "the fish does not swim"
    return float(np.corrcoef(ours, plants)[0, 1])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "real", "told", "sign"),
    [
        ("bno055", mounted("-z"), mounted("z"), -1),
        ("bno085", mounted("-z"), mounted("-z"), 1),
        pytest.param("bno055", mounted("-z"), mounted("-z"), 1, marks=pytest.mark.thorough),
        pytest.param("bno055", *2 * [turned(25, -40, 70)], 1, marks=pytest.mark.thorough),
        pytest.param("bno085", mounted("z"), mounted("z"), 1, marks=pytest.mark.thorough),
        pytest.param("bno085", *2 * [turned(0, 90, 30)], 1, marks=pytest.mark.thorough),
    ],
)
def test_the_loop_sees_the_plant_s_rate_with_its_sign(kind, real, told, sign):
    """The rig's sensor is mounted as `real` says, and the loop is told `told`."""
    with looped(fish_with(real), kind, told) as one:
        assert sign * likeness(one) > 0.5
        assert one.loop.disarm().reason is not None and one.torque == 0


def test_a_bno085_that_freezes_or_falls_silent_holds_the_swim_and_comes_back():
    with looped(fish_with(mounted("z")), "bno085", mounted("z")) as one:
        one.swim()
        one.rig.imu.faults.frozen = True
        one.ticks(lambda: one.loop.safety_status.state is State.HOLD)
        assert "numbers do not change" in one.loop.safety_status.text
        one.rig.imu.faults.frozen = False
        one.ticks(lambda: not one.loop.sensors.imu_fault)
        one.loop.disarm()
        one.swim()
        assert one.loop.devices.imu is not None
        one.loop.devices.imu.deadline = 0.008
        one.loop.limits = replace(WIDE, imu_hold=0.3)
        one.rig.imu.faults.mute = 10**6
        one.ticks(lambda: one.loop.safety_status.state is State.HOLD)
        assert "no yaw rate for" in one.loop.safety_status.text


@pytest.mark.thorough
def test_without_an_imu_the_loop_swims_nearer_on_the_camera_s_rate():
    with looped(load_fish("pulley-fish"), "bno055", None) as one:
        one.swim()
        target = np.array([1.5, 0.5])
        first = float(np.hypot(*(target - one.rig.shaft.pose[:2])))
        one.ticks(lambda: len([row for row in one.rows if row["state"] == "run"]) > 200)
        assert float(np.hypot(*(target - one.rig.shaft.pose[:2]))) < first - 0.1
        assert np.std([row["yaw_rate_rad_s"] for row in one.rows[-100:]]) > 0.05
        assert one.loop.health(time.monotonic()).imu_age < 1.0
        one.loop.disarm()


def test_the_camera_s_rate_is_that_of_the_accepted_poses():
    assert CameraYaw(Poses(link.Receiver(KEY), one_bounds())).read() is None
    turning = heard(*[(0.0, 0.0, 0.02 * k) for k in range(30)])
    assert turning.yaw_rate() == pytest.approx(0.02 * 60, rel=1e-4)
    jumped = heard(*[(0.0, 0.0, 0.02 * k) for k in range(30)], (0.9, 0.0, 3.0))
    assert jumped.yaw_rate() == pytest.approx(turning.yaw_rate(), rel=1e-4)


def one_bounds() -> Any:
    from tailbeat.robot.plausible import Bounds

    return Bounds()


# ---- the verbs ----------------------------------------------------------------------------------


def test_the_doctor_says_which_imu_there_is_or_that_there_is_none():
    parts = doctor.Parts(imu="none")
    (found,) = doctor.of_imu(parts, XW430)
    assert found.verdict == OK and found.found == "none: the camera gives the yaw rate"
    name = "pulley-fish-pool-generator"
    (refused,) = doctor.check_yaw_source(name, "none")
    assert refused.verdict == BAD and "trained with an IMU" in refused.found and refused.do
    (well,) = doctor.check_yaw_source(name, "/dev/ttyAMA0")
    assert well.verdict == OK and well.found == "from an IMU"
    assert doctor.check_yaw_source(name, "") == []


def test_a_drive_says_where_its_yaw_rate_comes_from():
    servo: Any = None
    station: Any = None
    none = Devices(servo, None, link.Receiver(KEY), station, ("", 0))
    assert session.yaw_source(none, XW430) == "the camera"
    assert "forced" in session.yaw_source(none, XW430, forced=True)
    with served(serve_bno055, Bno055(up=direction("-z"))) as (path, _):
        imu = imus.connect(path, Mounting(), PATIENT)
        imu.prepare()
        one = Devices(servo, imu, link.Receiver(KEY), station, ("", 0))
        assert session.yaw_source(one, mounted("-z")) == "BNO055, -z up"
        assert "WARNING: by gravity -z is up" in session.yaw_source(one, XW430)
        imu.close()


@pytest.mark.thorough
@pytest.mark.parametrize("imu", ["bno055", "bno085"])
def test_a_drive_takes_the_mounting_from_the_fish_that_drives(tmp_path: Path, imu):
    """Not from the fish inside the policy, whose IMU has z up."""
    text = fish_path("pulley-fish").read_text("utf-8")
    own = tmp_path / "own.toml"
    own.write_text(text.replace("[hardware]", '[hardware]\nimu_up = "-z"\n#'))
    words = ("--emulated", "--imu", imu, "--fish", own, "--seconds", 0.5)
    log = tmp_path / "a.mcap"
    done = tailbeat_process("drive", "pulley-fish-pool-generator", *words, "--log", log)
    assert f"yaw rate: {imu.upper()}, -z up\n" in done.stdout, done.stderr
    with log.open("rb") as held:
        notes = next(iter(make_reader(held).iter_metadata())).metadata
    assert notes["yaw_rate"] == f"{imu.upper()}, -z up"


@pytest.mark.thorough
def test_what_a_robot_without_an_imu_cannot_have_is_one_sentence(tmp_path: Path):
    policy, log = "pulley-fish-pool-generator", tmp_path / "a.mcap"
    for words, complaint in {
        ("--emulated", "--imu", "none"): "it was trained with an IMU",
        ("--emulated", "--imu", "none", "--fish", "pulley-fish"): "train --imu none",
        ("--emulated", "--force-camera-yaw-rate"): "it needs --imu none; omit it",
        ("--emulated", "--imu", "mpu"): "allowed are bno055, bno085 and none",
    }.items():
        done = tailbeat("drive", policy, *words, "--log", log)
        assert done.returncode == 2, done.stdout
        assert complaint in " ".join(done.stderr.split()) and "Traceback" not in done.stderr
    done = tailbeat("emulate", "--camera", tmp_path / "c.sock", "--imu", "mpu")
    assert done.returncode == 2 and "allowed for emulated devices are bno055" in done.stderr
    assert not log.exists()


def test_a_unit_names_the_fish_and_the_missing_imu(tmp_path: Path):
    words = ["pulley-fish-pool-generator", "--servo", "/dev/s", "--imu", "none", "--key", "k"]
    words += ["--listen", "h:1", "--station", "h:2", "--logs", "/var/log", "--fish", "pulley-fish"]
    out = tmp_path / "fish.service"
    done = tailbeat("unit", *words, "--out", out, "--force-camera-yaw-rate")
    assert done.returncode == 0, done.stderr
    assert "--imu none" in out.read_text()
    assert "--fish pulley-fish --force-camera-yaw-rate" in out.read_text()


@pytest.mark.thorough
def test_the_sign_test_tells_a_rotated_imu_that_is_upside_down():
    """It is tilted by 30 degrees, and turned about its own axis; then the same and turned over."""
    with looped(fish_with(turned(210, 0, 70)), "bno055", turned(30, 0, 70)) as one:
        one.loop.sign_test = True
        one.loop.signals.tested = False
        one.ticks(lambda: one.loop.devices.receiver.clock.offset(0) is not None)
        one.ticks(lambda: bool(one.loop.poses.seen) and one.loop.sensors.servo is not None)
        one.loop.arm(time.monotonic())
        one.loop.devices.servo.set((98, 1), 127)  # a thread may be late
        assert one.loop.swim().state is State.TEST, one.loop.safety_status
        one.ticks(lambda: one.loop.safety_status.state is not State.TEST)
        assert "it is upside down" in one.loop.safety_status.text
