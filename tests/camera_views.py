"""What tests that look at rendered pictures share: a calibration that knows the truth."""

from tailbeat.emulators.film import Filming, known_calibration
from tailbeat.emulators.optics import Optics
from tailbeat.vision.calibration import Calibration
from tailbeat.vision.tags import Tag

FISH, TARGET = Tag(height=-0.03), Tag()


def true_calibration(optics: Optics | None = None) -> Calibration:
    """Nothing measured."""
    return known_calibration(Filming(optics=optics or Optics(), fish=FISH, target=TARGET))
