"""Slow recordings leave a servo's fast motion open, and its datasheet decides it."""

from dataclasses import replace

import numpy as np
import pytest

from tailbeat.files import BadInput
from tailbeat.fish.catalogue import rad_per_s
from tailbeat.fish.store import load_fish
from tailbeat.identify.datasheet import DOUBT, Datasheet, datasheet, known, prior
from tailbeat.identify.search import Effort
from tailbeat.identify.servo import described_servo, servo_space
from tailbeat.identify.servo_job import ServoFit, identify_servo
from tailbeat.identify.servo_report import as_report, toml_values
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.shaft import Bench, Load, free_run

FISH = load_fish("pulley-fish")
COUNT = 2 * np.pi / 4096  # rad of an encoder's count
PENDULUM = Load("pendulum", inertia=0.016, weight=1.3)
# Like the STS3250 whose real logs showed the gap; its firmware damps inside the limit.
TRUTH = {"kp": 50.0, "kv": 0.6, "armature": 0.008, "damping": 0.65, "friction": 0.03}
REST = {"force_limit": 5.1, "delay": 0.002}
SHEET = Datasheet(4.9, 7.87)
SHORT = Effort(generations=40, population=32, polish=15, scouts=300)


def bench(name: str, motion, wobble: float = 0.0) -> Bench:
    """The servo with a pendulum, as an encoder reads it that errs by a `wobble` [rad]."""
    time = np.arange(0.0, 6.0, 0.02)
    blank = Bench(name, time, motion(time), 0 * time, np.ones_like(time), PENDULUM)
    servo = FISH.servos["identified"].model_copy(update=TRUTH | REST)
    angle = free_run(described_servo(servo), [blank])[0][0] + wobble * np.sin(8 * time)
    return replace(blank, angle=np.round(angle / COUNT) * COUNT)


def slow(wobble: float = 0.0) -> list[Bench]:
    """Two motions that never reach the force limit."""
    return [
        bench("sines", lambda t: 0.8 * np.sin(1.5 * t) + 0.3 * np.sin(4 * t), wobble),
        bench("up and down", lambda t: np.interp(t, [0, 3, 6], [0, 1.5, 1.0]), wobble),
    ]


def fast(wobble: float = 0.0) -> Bench:
    """A motion that ends faster than the servo can turn."""
    return bench("fast", lambda t: np.sin(t**2), wobble)


SLOW, FAST = slow(), fast()


def fitted(folder, sheet: Datasheet | None, runs=SLOW, held=FAST) -> ServoFit:
    config = ServoConfig(seeds=1, effort=SHORT, gears=False, datasheet=sheet)
    return identify_servo(FISH, runs, [held], config, folder)


def error(found: ServoFit, role: str) -> float:
    """Mean absolute error over the recordings of a role [deg]."""
    degrees = found.mae_deg(role)
    assert degrees is not None
    return degrees


@pytest.mark.thorough
def test_fast_motion_is_predicted_only_with_the_datasheet(tmp_path):
    alone, told = fitted(tmp_path, None), fitted(tmp_path, SHEET)
    for found in (alone, told):  # the slow motions do not tell them apart
        assert error(found, "fit") < 0.05
    assert error(alone, "validate") > 4 * error(told, "validate")
    assert told.to_naive < 0.5


@pytest.mark.thorough
def test_it_counts_as_much_for_a_servo_that_the_model_does_not_follow(tmp_path):
    """An encoder that errs by half a degree, so that residuals are several of their assumed
    deviations. They would outweigh a prior of a tenth; the interval stays that of a datasheet."""
    runs, held = slow(0.01), fast(0.01)
    found = fitted(tmp_path, SHEET, runs, held)
    assert {p.path: p.spread for p in found.space}["force_limit"] < DOUBT / 2
    low, high = found.estimates()["force_limit"].interval
    assert low < 0.85 * 4.9 and 1.15 * 4.9 < high < 1.4 * 4.9
    assert found.to_naive < 0.5 < fitted(tmp_path, None, runs, held).to_naive


@pytest.mark.thorough
def test_intervals_allow_for_a_datasheet_that_is_a_tenth_off(tmp_path):
    found = fitted(tmp_path, Datasheet(5.1 * 0.9, 5.1 / 0.65 * 1.1))
    advice = [pair["separated_by"] for pair in as_report(found)["trade_offs"]]
    assert advice and not any("--datasheet" in one for one in advice)
    for name, true in (("force_limit", 5.1), ("damping", 0.65)):
        low, high = found.estimates()[name].interval
        assert low < true < high < 2 * low
        assert not found.estimates()[name].decided
    written = str(toml_values(found, ["sines"])["servos.identified.force_limit"])
    assert "by the datasheet; not decided by the data" in written


@pytest.mark.thorough
def test_recordings_that_decide_outweigh_a_wrong_datasheet_and_say_so(tmp_path):
    wrong = Datasheet(3.0, 7.87)
    found = fitted(tmp_path, wrong, [*SLOW, FAST], SLOW[0])
    assert found.servo["force_limit"] == pytest.approx(5.1, rel=0.05)
    said = [one for one in found.warnings if "force_limit" in one]
    assert len(said) == 1 and "the datasheet for 3:" in said[0]
    assert as_report(found)["datasheet"] == {"stall": 3.0, "no_load": 7.87}


def test_the_prior_is_the_datasheet_s_and_narrower_for_a_servo_that_fits_badly():
    plain = servo_space(SLOW, gears=True)
    found = {p.path: p for p in known(plain, SHEET, np.full(50, 4.0), 50)}
    assert found["force_limit"].prior == 4.9 and found["damping"].prior == 4.9 / 7.87
    assert found["force_limit"].spread == DOUBT / 4 and found["kv"].spread == 4.9 / 7.87
    usual = {p.path: p for p in plain}
    assert {n for n in found if found[n] != usual[n]} == {"force_limit", "damping", "kv"}
    exact = known(plain, SHEET, np.full(50, 0.1), 50)
    assert {p.path: p.spread for p in exact}["force_limit"] == DOUBT


def test_torque_and_speed_err_apart_and_the_damping_by_both():
    space = known(servo_space(SLOW, gears=True), SHEET, np.full(50, 4.0), 50)
    spread = np.array([p.spread for p in space])
    found = prior(space, SHEET) * np.outer(spread, spread)  # of ln(value)
    limit, damping = ([p.path for p in space].index(n) for n in ("force_limit", "damping"))
    speed = np.zeros(len(space))
    speed[limit], speed[damping] = 1, -1  # of ln(limit / damping)
    assert found[limit, limit] == pytest.approx(DOUBT**2)
    assert speed @ found @ speed == pytest.approx(DOUBT**2)
    assert (prior(space, None) == np.eye(len(space))).all()


def test_a_datasheet_is_two_numbers_or_a_servo_of_the_catalogue_at_a_supply():
    assert datasheet("4.9, 75") == Datasheet(4.9, rad_per_s(75))
    assert datasheet("XL330@5") == Datasheet(0.52, rad_per_s(103))
    doubled = datasheet("xl330@10")
    assert (doubled.stall, doubled.no_load) == (2 * 0.52, 2 * rad_per_s(103))
    for wrong in ("4.9", "x,1", "0,5", "inf,5", "4.9,nan", "1,2,3", "xl330", "xl330@", "no@5"):
        with pytest.raises(BadInput, match="give the stall torque"):
            datasheet(wrong)
    for printed in ("50,0.133", "500,75", "0.001,75", "1e300,1e-300", "xl330@1e9"):
        with pytest.raises(BadInput, match="A kg cm is"):
            datasheet(printed)
