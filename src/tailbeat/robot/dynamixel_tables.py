"""Control tables of ROBOTIS servos that speak Protocol 2.0: the X series and the P series.

Addresses, bytes and units: the tables in the maker's `dynamixel_easy_sdk` (dynamixel-sdk 4.1.0),
and its e-manual for what an error bit means; nothing was checked on a real servo. The EEPROM has
the same addresses in both series. The X series without the XL-320 shares one table with the MX-28
(2.0). A P servo counts in pulses of its own gear, from 0 at the middle.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

Register = tuple[int, int]  # address, bytes

MODEL, FIRMWARE, ID, BAUD, RETURN_DELAY = (0, 2), (6, 1), (7, 1), (8, 1), (9, 1)
DRIVE_MODE, OPERATING_MODE, HOMING = (10, 1), (11, 1), (20, 4)
HIGHEST, LOWEST, SHUTDOWN = (48, 4), (52, 4), (63, 1)
RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True)
class Table:
    """The registers of the RAM, and units: `steps` counts of a turn (0: not known), the count of
    the straight tail (`centre`), `velocity` [rad/s] of a count; `errors` names the bits of the
    hardware error. The state is read from `moving` to `temperature`, which has no gap."""

    steps: int
    centre: int
    velocity: float
    torque: Register
    return_level: Register
    hardware_error: Register
    gain: Register
    bus_watchdog: Register
    profile_acceleration: Register
    profile_velocity: Register
    goal: Register
    moving: Register
    present_current: Register
    present_velocity: Register
    present_position: Register
    present_voltage: Register
    temperature: Register
    errors: Mapping[int, str]

    @property
    def count(self) -> float:
        """Angle of one count [rad]."""
        return 2 * math.pi / self.steps

    @property
    def state(self) -> Register:
        """First address and bytes of a reading."""
        return self.moving[0], self.temperature[0] + 1 - self.moving[0]


ERRORS = {0: "voltage", 2: "overheat", 3: "encoder", 4: "electrical shock", 5: "overload"}
X = Table(
    steps=4096,
    centre=2048,
    velocity=0.229 * RPM,
    torque=(64, 1),
    return_level=(68, 1),
    hardware_error=(70, 1),
    gain=(84, 2),
    bus_watchdog=(98, 1),
    profile_acceleration=(108, 4),
    profile_velocity=(112, 4),
    goal=(116, 4),
    moving=(122, 1),
    present_current=(126, 2),
    present_velocity=(128, 4),
    present_position=(132, 4),
    present_voltage=(144, 2),
    temperature=(146, 1),
    errors=ERRORS,
)
P = Table(
    steps=0,
    centre=0,
    velocity=0.01 * RPM,
    torque=(512, 1),
    return_level=(516, 1),
    hardware_error=(518, 1),
    gain=(532, 2),
    bus_watchdog=(546, 1),
    profile_acceleration=(556, 4),
    profile_velocity=(560, 4),
    goal=(564, 4),
    moving=(570, 1),
    present_current=(574, 2),
    present_velocity=(576, 4),
    present_position=(580, 4),
    present_voltage=(592, 2),
    temperature=(594, 1),
    errors=ERRORS | {1: "hall sensor"},
)
# Counts of a turn of each P model, by its model number.
P_STEPS = {
    2000: 607_500,  # PH42-020-S300
    2010: 1_003_846,  # PH54-100-S500
    2020: 1_003_846,  # PH54-200-S500
    2100: 526_374,  # PM42-010-S260
    2110: 502_834,  # PM54-040-S250
    2120: 502_834,  # PM54-060-S250
}
P_NUMBERS = range(2000, 2200)


def table_of(number: int) -> Table:
    """The table of a model, by its number; a P model that is not listed has no `steps`."""
    return replace(P, steps=P_STEPS.get(number, 0)) if number in P_NUMBERS else X
