"""What tests that look at rendered pictures share: a calibration that knows the truth."""

import numpy as np

from tailbeat.pool.optics import Optics
from tailbeat.swim.calibration import Calibration, Hung, Lens
from tailbeat.swim.tags import Tag

FISH, TARGET = Tag(height=-0.03), Tag()


def true_lens(optics: Optics) -> Lens:
    """The lens that the pictures are drawn through."""
    (x, y), f = optics.centre, optics.focal
    matrix = np.array([[f, 0, x], [0, f, y], [0, 0, 1.0]])
    return Lens(optics.size, matrix, np.array([*optics.radial, *optics.tangential, 0.0]), 0.0)


def true_calibration(optics: Optics | None = None) -> Calibration:
    """Nothing measured."""
    optics = optics or Optics()
    hung = Hung(optics.rotation, np.array(optics.position), 0.0)
    return Calibration(true_lens(optics), hung, FISH, TARGET, optics.index)
