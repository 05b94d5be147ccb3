"""The camera sees the fish's tag everywhere in the pool; where one does not, that is said."""

import numpy as np
import pytest

from camera_views import FISH, TARGET, true_calibration
from tailbeat.emulators.camera import Renderer, Scene, calm
from tailbeat.emulators.optics import Optics
from tailbeat.link.places import POOL
from tailbeat.vision.field_of_view import NEAR, blind, unseen
from tailbeat.vision.tracker import Tracker
from test_tracker import film

LOW = Optics(position=(0.05, -0.03, 3.0))  # as the emulated camera hung until November 2026


def seen(optics: Optics, place: tuple[float, float], turns: int = 4) -> bool:
    """Whether a tracker finds a rendered tag at a place, turned in several ways."""
    renderer = Renderer(optics, calm(), FISH, TARGET)
    tracker = Tracker(true_calibration(optics))
    scenes = [Scene((*place, k * np.pi / 8)) for k in range(turns)]
    frames = [film(tracker, renderer, [scene] * 4) for scene in scenes]
    return all(rows[-1].frame.fish is not None for rows in frames)


@pytest.mark.thorough
def test_the_emulated_camera_sees_the_whole_pool():
    """It hung too low: everyday tours lost the fish beside one wall, where it drifted unseen."""
    assert max(unseen(true_calibration())) <= NEAR and blind(true_calibration()) == ""
    assert seen(Optics(), (0.5, POOL[1] / 2 - 0.04)) and not seen(LOW, (0.5, POOL[1] / 2 - 0.04))


@pytest.mark.thorough
def test_a_strip_that_is_not_seen_is_named_and_ends_where_rendered_tags_do():
    made = true_calibration(LOW)
    strip = unseen(made)
    assert strip[3] > 0.04 and strip[2] == 0.0
    edge = POOL[1] / 2 - strip[3]
    assert seen(LOW, (0.5, edge - 0.02)) and not seen(LOW, (0.5, edge + 0.03))
    assert "cm along the wall at y = 1.35 m" in blind(made)


@pytest.mark.parametrize(("shift", "wall"), [((1.0, 0.0), 0), ((-1.0, 0.0), 1)])
def test_a_camera_that_hangs_aside_misses_the_other_end(shift, wall):
    found = unseen(true_calibration(Optics(position=(*shift, 3.2))))
    assert found[wall] > 0.5 > found[1 - wall]
