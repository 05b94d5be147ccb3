"""The servo as bought: every servo of the catalogue on the line, told apart by the driver."""

from dataclasses import replace

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, servo_bench
from support import complaint
from tailbeat.emulators.rig import open_filmed_rig
from tailbeat.files import BadInput
from tailbeat.fish.catalogue import Profile, profiles
from tailbeat.fish.description import Hardware
from tailbeat.fish.first_draft import new_fish
from tailbeat.fish.proportions import Given
from tailbeat.fish.store import digest, fish_path, hardware_of, load_fish, with_values
from tailbeat.link.datagrams import make_key
from tailbeat.robot import doctor_devices
from tailbeat.robot.doctor_devices import check_before_driving
from tailbeat.robot.findings import OK, WARN
from tailbeat.robot.fits import check_same_body
from tailbeat.robot.safety import HOLDS, STOPS, Health, SafetyLimits, first_broken, limits_for
from tailbeat.robot.servo import connect

SPOKEN = [one for one in profiles().values() if one.hardware()]
HEALTHY = Health(pose_age=0, imu_age=0, servo_age=0, clock_doubt=0, target=True)


def named(profile: Profile) -> str:
    return profile.name


def own(profile: Profile) -> Hardware:
    found = profile.hardware()
    assert found is not None
    return found


@pytest.mark.realtime
@pytest.mark.parametrize("profile", SPOKEN, ids=named)
def test_a_servo_of_the_catalogue_is_driven_in_its_own_units(profile):
    hardware = own(profile)
    with servo_bench(hardware) as bench:
        servo = connect(bench.path, hardware, deadline=PATIENT)
        bench.device.put(69 if hardware.family == "feetech-sts" else 126, 500)
        state = servo.read()
        found = doctor_devices.check_servo(servo, hardware)
        servo.close()
    assert state.voltage == pytest.approx(profile.voltage_v)
    most = profile.current_ma or profile.stall_a  # mA of one count
    assert state.current == pytest.approx(500 * most / 1000)
    verdicts = {one.name: one.verdict for one in found}
    assert verdicts["servo supply"] == verdicts["servo position gain"] == OK


@pytest.mark.realtime
def test_the_maker_s_library_knows_each_servo_by_its_number():
    sdk = pytest.importorskip("dynamixel_sdk")
    for profile in (one for one in SPOKEN if one.family == "dynamixel-x"):
        with servo_bench(own(profile)) as bench:
            port, packets = sdk.PortHandler(bench.path), sdk.PacketHandler(2.0)
            assert port.openPort()
            heard = [packets.ping(port, 1) for _ in range(20)]
            port.closePort()
        assert (profile.number, 0, 0) in heard


@pytest.mark.realtime
def test_another_servo_than_the_fish_s_is_refused():
    xl330 = own(profiles()["xl330"])
    with (
        servo_bench(xl330) as bench,
        pytest.raises(BadInput, match="number 1200 answers, the fish's XW430-T200-R has 1280"),
    ):
        connect(bench.path, XW430, deadline=PATIENT)


@pytest.mark.realtime
def test_the_doctor_warns_of_another_gain_than_the_identified_one():
    with servo_bench() as bench:
        bench.device.put(84, 400)
        servo = connect(bench.path, XW430, deadline=PATIENT)
        found = {one.name: one for one in doctor_devices.check_servo(servo, XW430)}
        servo.close()
    assert found["servo position gain"].verdict == WARN
    assert "write 900 to register 84" in found["servo position gain"].do


def test_limits_are_the_servo_s_own():
    """Five volts are an XL330's supply and a fault of an XW430; one and a half ampere the
    reverse."""
    small, large = limits_for(own(profiles()["xl330"])), limits_for(XW430)
    assert large == SafetyLimits()  # the defaults are the paper's servo's
    low = replace(HEALTHY, voltage=5.0)
    assert first_broken(HOLDS, low, small) is None
    assert first_broken(HOLDS, low, large) is not None
    loaded = replace(HEALTHY, voltage=5.0, current=1.5)
    assert first_broken(STOPS, loaded, small) is not None
    assert first_broken(STOPS, loaded, large) is None
    assert small.temperature_stop == 65.0


def test_an_emulated_fish_has_its_own_servo():
    fish = load_fish("pulley-fish").model_copy(update={"hardware": own(profiles()["xm430"])})
    rig = open_filmed_rig(fish, None, (1.0, 0.0))  # type: ignore[arg-type]
    assert rig.servo.get(0) == 1020 and rig.servo.get(84) == 800
    assert hardware_of(fish.model_copy(update={"hardware": None})) == XW430


def test_twin_and_policy_do_not_depend_on_what_was_bought():
    fish = load_fish("pulley-fish")
    other = fish.model_copy(update={"hardware": own(profiles()["xm430"])})
    assert digest(other) == digest(fish)
    check_same_body(fish, other)
    assert digest(with_values(fish, {"tail.damping_time": 0.02})) != digest(fish)


def test_a_supply_that_the_servo_does_not_take_is_refused(tmp_path):
    before = fish_path("pulley-fish").read_text("utf-8")
    (tmp_path / "wet.toml").write_text(before.replace('supply = "12 V"', 'supply = "24 V"'))
    said = complaint("show", tmp_path / "wet.toml")
    assert "hardware.supply is 24 V; the servo takes 9.5 to 16 V" in said


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["xl330", "sts3215"])
def test_a_sketch_carries_its_servo(tmp_path, name):
    new_fish(tmp_path / "a.toml", Given(length=0.28, mass=0.35, hinges=4, servo=name))
    assert load_fish(tmp_path / "a.toml").hardware == own(profiles()[name])


def test_a_servo_without_a_model_number_has_no_driver():
    assert Profile("new", "New", 5.0, 1.0, 60.0, 20.0).hardware() is None


# ---- before it moves ----------------------------------------------------------------------------

REFUSED = {
    "drive mode": (10, 1, "servo drive mode is 1: reversed"),
    "shutdown": (63, 0, "servo shutdown is 0b0: overload does not turn torque off"),
    "supply": (144, 91, "servo supply is 9.1 V"),
    "hardware error": (70, 0b100000, "servo hardware error is overload"),
}


@pytest.mark.realtime
@pytest.mark.parametrize("name", REFUSED)
def test_what_the_doctor_calls_bad_is_refused_before_anything_moves(name):
    address, value, said = REFUSED[name]
    with servo_bench() as bench:
        bench.device.put(address, value)
        servo = connect(bench.path, XW430, deadline=PATIENT)
        with pytest.raises(BadInput, match=said):
            check_before_driving(bench.path, servo, XW430)
        assert not bench.on
        servo.close()


@pytest.mark.realtime
def test_a_bus_that_leaves_no_room_in_a_period_is_refused():
    with servo_bench() as bench:
        bench.device.faults.slow = 0.012
        servo = connect(bench.path, XW430, deadline=PATIENT)
        with pytest.raises(
            BadInput, match=r"servo reading time is median \d+.* ms.*: latency timer"
        ):
            check_before_driving(bench.path, servo, XW430)
        bench.device.faults.slow = 0.0
        check_before_driving(bench.path, servo, XW430)
        servo.close()


@pytest.mark.realtime
def test_what_arming_mends_is_not_refused():
    with servo_bench() as bench:
        bench.device.put(52, 2100)
        bench.device.put(11, 16)
        servo = connect(bench.path, XW430, deadline=PATIENT)
        check_before_driving(bench.path, servo, XW430)
        servo.close()


@pytest.mark.realtime
def test_a_drive_on_a_reversed_servo_ends_with_a_sentence(tmp_path):
    make_key(tmp_path / "fish.key")
    with servo_bench() as bench:
        bench.device.put(10, 1)
        said = complaint(
            "drive", "pulley-fish-pool-generator", "--servo", bench.path, "--imu", bench.path,
            "--listen", "127.0.0.1:0", "--station", "127.0.0.1:9", "--key", tmp_path / "fish.key",
            "--log", tmp_path / "a.mcap",
        )  # fmt: skip
        assert "servo drive mode is 1: reversed" in said and not bench.on
