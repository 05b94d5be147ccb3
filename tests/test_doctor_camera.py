"""The doctor above the pool: each question on a virtual camera that is really so."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")

from camera_views import FISH, TARGET, true_calibration
from tailbeat.emulators.camera import Scene
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import Filming
from tailbeat.robot.doctor_camera import check_camera
from tailbeat.robot.findings import Finding
from tailbeat.vision.calibration import write_calibration

pytestmark = pytest.mark.realtime

IDS = (0, 1)
WELL = Scene(fish=(0.6, -0.4, 0.7), target=(-1.0, 0.5, 0.0))
Look = Callable[[Scene], dict[str, Finding]]


@pytest.fixture(scope="module")
def look(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Look]:
    folder = tmp_path_factory.mktemp("sight")
    write_calibration(folder / "camera.json", true_calibration())
    camera = start_camera(folder / "c", Filming(fish=FISH, target=TARGET, rate=30.0))

    def looked(scene: Scene) -> dict[str, Finding]:
        camera.show(scene)
        return {one.name: one for one in check_camera(camera.where, folder / "camera.json", IDS)}

    yield looked
    camera.close()


def test_a_camera_that_sees_both_tags_is_well(look):
    found = look(WELL)
    names = ("calibration", "camera", "exposure", "fish's tag", "target's tag", "size of the tags")
    assert {name: found[name].verdict for name in names} == dict.fromkeys(names, "ok")
    assert float(found["frames per second"].found) > 3  # of a loaded machine


@pytest.mark.thorough
def test_a_missing_tag_is_told_apart_from_a_second_print_of_it(look):
    gone = look(replace(WELL, fish=None))["fish's tag"]
    assert gone.verdict == "bad" and "in 0 % of frames" in gone.found and gone.do
    twice = look(replace(WELL, others=((0, (-0.5, -0.5, 0.0)),)))["fish's tag"]
    assert twice.verdict == "bad" and "seen twice" in twice.found
    target = look(replace(WELL, target=None))["target's tag"]
    assert target.verdict == "warn"  # one can be dragged instead


def test_no_camera_and_no_calibration_are_one_finding_each(tmp_path):
    kept = tmp_path / "camera.json"
    write_calibration(kept, true_calibration())
    found = check_camera(f"unix:{tmp_path}/nothing", kept, IDS)
    assert [one.verdict for one in found] == ["ok", "ok", "bad"] and "start the" in found[2].found
    lost = check_camera("/dev/video0", tmp_path / "none.json", IDS)
    assert [one.name for one in lost] == ["calibration"] and lost[0].verdict == "bad"
