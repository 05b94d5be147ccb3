"""The tag's size belongs to the fish: sheets, emulated camera and checks have it from there."""

import re

import numpy as np
import pytest

from support import complaint, tailbeat
from tailbeat.emulators.camera import Conditions, Renderer, Scene
from tailbeat.emulators.film import Filming, filming_of, known_calibration
from tailbeat.emulators.optics import above
from tailbeat.fish import first_draft
from tailbeat.fish.proportions import Given
from tailbeat.fish.store import digest, load_fish, with_values
from tailbeat.link.places import POOL, room
from tailbeat.robot.doctor_camera import check_camera
from tailbeat.vision.calibration import write_calibration
from tailbeat.vision.detector import open_detector
from tailbeat.vision.field_of_view import NEAR, unseen
from tailbeat.vision.tags import Tag, of_other_size
from tailbeat.vision.tracker import Tracker
from test_track import MM, printed

PULLEY = load_fish("pulley-fish")
COUNT, FRAME = 20, 1 / 60


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The file of a fish of 0.28 m, and the fish."""
    path = tmp_path_factory.mktemp("small") / "mine.toml"
    first_draft.new_fish(path, Given(0.28, 0.35, 4, "xl330"))
    return path, load_fish(path)


def found(filming: Filming) -> tuple[float, float]:
    """The share of frames in which a fish all over its pool is found, and the rms of its place
    [m]."""
    rng, half = np.random.default_rng(3), np.array(filming.optics.pool) / 2 - 0.2
    renderer = Renderer(filming.optics, Conditions(), filming.fish, filming.target)
    tracker, off = Tracker(known_calibration(filming)), []
    for k in range(COUNT):
        pose = (*(half * rng.uniform(-1, 1, 2)).tolist(), rng.uniform(-3, 3))
        for i in (2 * k, 2 * k + 1):  # a tag is believed when it is seen twice
            seen = tracker.see(
                renderer.draw(Scene(pose), i * FRAME), round(6e10 * k + 1e9 * i * FRAME)
            )
        if seen.frame.fish is not None:
            off.append(np.subtract(seen.frame.fish[:2], pose[:2]))
    return len(off) / COUNT, float(np.sqrt(np.mean(np.square(off)))) if off else np.inf


@pytest.mark.thorough
def test_a_small_tag_is_seen_by_a_camera_with_more_pixels_and_not_by_the_usual_one(small):
    filming = filming_of(small[1])
    assert filming.fish.side == pytest.approx(0.04) and filming.optics.size[0] > 1800
    share, rms = found(filming)
    assert share > 0.9 and rms < 0.005
    usual = Filming(fish=filming.fish, target=filming.target)
    assert found(usual)[0] < 0.5  # the emulated camera filmed a tag of 80 mm on every fish


@pytest.mark.parametrize("reach", [0.4, 1.0, 1.6])
def test_a_camera_above_any_pool_sees_all_of_it(reach):
    optics = above(room(reach), 0.08 * reach)
    assert optics.pool == room(reach) and optics.size == (1280, 720)
    made = known_calibration(Filming(optics, fish=Tag(0.08 * reach, -0.03)))
    assert max(unseen(made)) <= NEAR * reach


def test_the_paper_s_fish_has_the_camera_of_before():
    assert filming_of(PULLEY) == Filming()


@pytest.mark.thorough
def test_a_tag_that_is_too_wide_for_the_head_is_refused(small, tmp_path):
    text = small[0].read_text(encoding="utf-8")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(re.sub(r'tag = "40 mm"', 'tag = "80 mm"', text), encoding="utf-8")
    said = complaint("show", wrong)
    assert "tag is 80 mm wide, and the head" in said


def test_the_tag_is_no_matter_to_a_policy():
    assert digest(with_values(PULLEY, {"tag": 0.06})) == digest(PULLEY)


@pytest.mark.thorough
def test_the_sheets_have_the_fish_s_own_size(small, tmp_path):
    assert tailbeat("tags", "--out", tmp_path / "own.png", "--fish", small[0]).returncode == 0
    assert tailbeat("tags", "--out", tmp_path / "any.png").returncode == 0
    pages = [printed(tmp_path / f"{name}-fish.png") for name in ("own", "any")]
    sides = [open_detector().find(page)[0].side / MM for page in pages]
    assert sides == pytest.approx([40, 80], abs=0.15)


@pytest.mark.thorough
def test_a_calibration_for_another_tag_is_told(small, tmp_path):
    made = known_calibration(Filming())
    assert of_other_size(made.fish, None) == of_other_size(made.fish, 0.081) == ""
    kept = tmp_path / "camera.json"
    write_calibration(kept, made)
    told = {one.name: one for one in check_camera("no.avi", kept, (0, 1), small[1].tag)}
    own = told["size of the fish's tag"]
    assert own.verdict == "bad" and "a tag of 80 mm, and the fish's has 40 mm" in own.found
    assert "size of the fish's tag" not in {
        one.name for one in check_camera("no.avi", kept, (0, 1), 0.08)
    }
    assert POOL == made.pool
