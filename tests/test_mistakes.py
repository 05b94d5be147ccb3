"""A messy lab in the emulated devices: the same errors as in the trials; a clean one has none."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")

from camera_views import FISH as TAG
from camera_views import TARGET, true_calibration
from support import complaint
from tailbeat.emulators.camera import Renderer, calm
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import Filming
from tailbeat.emulators.lab import miscalibrated
from tailbeat.emulators.mistakes import Mistakes
from tailbeat.emulators.optics import Optics, project
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.emulators.rig import close_rig, open_filmed_rig, open_rig
from tailbeat.emulators.watchers import Above
from tailbeat.env import errors
from tailbeat.env.errors import Errors
from tailbeat.env.sensors import quiet
from tailbeat.fish.store import load_fish
from tailbeat.link.places import POOL
from tailbeat.pool.mess import Lab, level
from tailbeat.pool.mess import draw as draw_lab
from tailbeat.vision.tracker import Tracker
from test_tracker import film

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


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_calibration_reads_true_pixels_as_the_lab_s_errors_say(seed):
    wrong = draw_lab(level("everyday"), [seed]).errors
    half = np.array(POOL) / 2
    places = np.stack(np.meshgrid(*[np.linspace(-h, h, 9) for h in half]), axis=-1).reshape(-1, 2)
    pixels = project(Optics(), np.column_stack([places, np.full(len(places), TAG.height)]))
    read = miscalibrated(true_calibration(), wrong).places(pixels, TAG.height)
    asked = errors.seen(errors.rows([wrong]), places)
    off = np.linalg.norm(read - asked, axis=1).max()
    size = np.linalg.norm(asked - places, axis=1).max()
    assert size > 0.01 and off < 0.15 * size
    right = miscalibrated(true_calibration(), errors.NONE).places(pixels, TAG.height)
    assert np.allclose(right, places, atol=1e-4)


@pytest.mark.thorough
def test_a_camera_with_a_wrong_scale_sees_the_tag_at_a_wall_and_the_tracker_reads_it_wrong(
    tmp_path,
):
    """The emulated picture showed the tag where the wrong calibration put it: outside."""
    wrong = Errors(ahead=0.02, askew=0.1, scale=0.06, turn=0.05)
    eye = start_camera(tmp_path / "eye", Filming())
    made = open_filmed_rig(FISH, eye, (-1.0, 0.5), lab=Lab(errors=wrong))
    try:
        made.shaft.put(at := (1.2, POOL[1] / 2 - 0.05, 0.1))
        assert isinstance(made.watch, Above)
        scene = made.watch._scene(made.shaft, 0.0)
    finally:
        close_rig(made)
    tracker = Tracker(miscalibrated(true_calibration(), wrong))
    seen = film(tracker, Renderer(Optics(), calm(), TAG, TARGET), [scene] * 4)[-1].frame
    row = errors.rows([wrong])
    assert seen.fish is not None and seen.target is not None
    assert np.allclose(seen.fish, errors.filmed(row, np.array([at]))[0], atol=0.01)
    assert np.allclose(seen.target, errors.seen(row, np.array([[-1.0, 0.5]]))[0], atol=0.01)


def test_an_unknown_mess_is_refused_by_the_verbs_that_take_one(tmp_path):
    said = "mess 'dirty': allowed are clean, everyday, rough, wrecked, or a TOML file"
    assert said in complaint("emulate", "--camera", tmp_path / "c.sock", "--mess", "dirty")
    words = ("swim", "--headless", "--direct", "--out", tmp_path / "out", "--mess", "dirty")
    assert said in complaint(*words)
