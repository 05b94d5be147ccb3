"""In what the control tables of X-series servos differ (ROBOTIS e-manual, one page per model).

A model that is not listed is emulated as an XW430-T200. Addresses are the same in all.
"""

from dataclasses import dataclass

ALL_MODES, WITHOUT_CURRENT = (0, 1, 3, 4, 5, 16), (1, 3, 4, 16)


@dataclass(frozen=True)
class Model:
    """Factory limits: of velocity [0.229 rev/min], of current [its own unit], 0 for a servo that
    measures none and so has no modes of current; the range of its voltage limits [0.1 V]; which
    errors turn torque off."""

    velocity: int = 235
    current: int = 2047
    volts: tuple[int, int] = (95, 160)
    shutdown: int = 52

    @property
    def modes(self) -> tuple[int, ...]:
        """Its operating modes."""
        return ALL_MODES if self.current else WITHOUT_CURRENT


MODELS = {
    30: Model(230, 0),  # MX-28 (2.0)
    1020: Model(200, 1193),  # XM430-W350, firmware 42 or newer
    1060: Model(265, 0, (60, 140)),  # XL430-W250
    1090: Model(250, 0, (60, 140)),  # 2XL430-W250
    1120: Model(128, 2047),  # XM540-W270
    1170: Model(167, 2047),  # XW540-T260
    1200: Model(445, 1750, (31, 70), 53),  # XL330-M288
    1240: Model(350, 2352, (31, 70)),  # XC330-M288
    1280: Model(),  # XW430-T200
}
