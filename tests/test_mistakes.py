"""A messy lab in the emulated devices: the same errors as in the trials; a clean one has none."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")

from support import complaint
from tailbeat.emulators.mistakes import Mistakes
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.emulators.rig import close_rig, open_rig
from tailbeat.env import errors
from tailbeat.env.errors import Errors
from tailbeat.env.sensors import quiet
from tailbeat.fish.store import load_fish
from tailbeat.pool.mess import Lab

FISH = load_fish("pulley-fish")
WRONG = Errors(horn=0.1, encoder=0.02, ahead=0.02, left=0.01, askew=0.1, scale=0.03, dark=0.3)


def turned(lab: Lab, goal: float) -> PlantShaft:
    """A shaft after a second at one goal."""
    shaft = PlantShaft(fish=FISH, mistakes=Mistakes(lab))
    shaft.advance(goal, 1.0)
    return shaft


def test_a_horn_off_its_zero_is_off_in_the_plant_and_unseen_by_the_servo():
    off, good = turned(Lab(errors=WRONG), 0.0), turned(Lab(), 0.1)
    assert np.array_equal(off.state.q, good.state.q)  # a good horn at that command
    assert off.angle == pytest.approx(good.angle - 0.1 + 0.02, abs=1e-12)


def test_the_station_sees_the_tag_where_it_is_glued_and_loses_it_in_bursts():
    made = open_rig(FISH, b"k" * 32, ("127.0.0.1", 9), (1.0, 0.5), lab=Lab(errors=WRONG))
    try:
        made.station.model = quiet()
        made.shaft.put((0.4, 0.3, 0.5))
        began = made.shaft.began
        frames = [made.station._film(made.shaft, began + 0.02 * k + 0.01) for k in range(3000)]
    finally:
        close_rig(made)
    seen = [frame for frame in frames if frame.fish is not None]
    row = errors.rows([WRONG])
    first = seen[0]
    assert first.fish is not None and first.target is not None
    assert np.allclose(first.fish, errors.filmed(row, np.array([[0.4, 0.3, 0.5]]))[0])
    assert np.allclose(first.target, errors.seen(row, np.array([[1.0, 0.5]]))[0])
    assert 0.1 < 1 - len(seen) / len(frames) < 0.4  # bursts of 0.3 s, one a second


def test_a_gyro_s_heading_is_the_integral_of_its_rate():
    own = Mistakes(Lab(errors=Errors(yaw_rate_bias=0.1, yaw_rate_drift=0.05)))
    time = np.arange(0, 60, 0.01)
    heading, rate = np.array([own.gyro(t) for t in time]).T
    assert np.allclose(np.gradient(heading, 0.01)[1:-1], rate[1:-1], atol=1e-4)
    assert rate[0] == pytest.approx(0.1) and rate[-1] == pytest.approx(0.15)
    assert Mistakes().gyro(10.0) == (0.0, 0.0) and not Mistakes().hidden(10.0)


def test_an_unknown_mess_is_refused_by_the_verbs_that_take_one(tmp_path):
    said = "mess 'dirty': allowed are clean, everyday, rough, wrecked."
    assert said in complaint("emulate", "--camera", tmp_path / "c.sock", "--mess", "dirty")
    words = ("swim", "--headless", "--direct", "--out", tmp_path / "out", "--mess", "dirty")
    assert said in complaint(*words)
