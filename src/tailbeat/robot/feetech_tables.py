"""Memory tables of Feetech servos: STS and SCS, by family.

STS: the maker's memory table of its STS servos with magnetic encoder, compared with its SDK
(ftservo-python-sdk 2.0.1) and with rustypot 1.13.1. SCS: the same SDK's class `scscl`, and rustypot
1.13.1 for what that lacks: units and the angle of a count (300 degrees over 1024). Nothing was
checked on a real servo. Registers from 3 to 21, 40, 42, 46 and 56 to 70 are at the same addresses.
"""

import math
from dataclasses import dataclass
from typing import Literal

from tailbeat.fish.description import Family

Register = tuple[int, int]  # address, bytes

BAUDS = {1_000_000: 0, 500_000: 1, 115_200: 4, 57_600: 6, 250_000: 2, 128_000: 3, 38_400: 7}
BAUDS |= {76_800: 5}
MAJOR, MINOR, MODEL, ID, BAUD = (0, 1), (1, 1), (3, 2), (5, 1), (6, 1)
RETURN_DELAY, LEVEL, LOWEST, HIGHEST = (7, 1), (8, 1), (9, 2), (11, 2)
PHASE, UNLOADING, GAIN, MODE = (18, 1), (19, 1), (21, 1), (33, 1)
TORQUE, ACCELERATION, GOAL, TIME, SPEED = (40, 1), (41, 1), (42, 2), (44, 2), (46, 2)
STATUS, FASTEST = (65, 1), (84, 1)
FINE, ZERO_IS_FASTEST, TURNS = 4, 8, 16  # bits of the phase
COARSE = 50  # counts/s: unit of speed 84, and of all speeds if the phase is not `FINE`


@dataclass(frozen=True)
class Table:
    """In what the families differ: byte order of words, angle of a count [rad], the count of the
    straight tail (`centre`), the `lock` of the EEPROM, the phase's bit that reverses it, which
    errors must turn torque off, and the registers that are 0 for goals without a ramp (`plain`).

    `modes`: it has a register for its mode and one for its return delay, speeds in the units of its
    phase, and positions beyond a turn.
    """

    order: Literal["little", "big"]
    count: float
    centre: int
    lock: Register
    reversed: int
    errors: int
    plain: Register
    modes: bool

    def speed_unit(self, phase: int) -> float:
        """Speed of one count [rad/s]."""
        return self.count * (1 if phase & FINE or not self.modes else COARSE)


STS = Table("little", 2 * math.pi / 4096, 2048, (55, 1), 128, 0b101100, ACCELERATION, modes=True)
SCS = Table("big", math.radians(300) / 1024, 511, (48, 1), 1, 0b100100, TIME, modes=False)
SCS_FASTEST = 1023  # counts/s, the highest speed that it takes


def table_of(family: Family) -> Table:
    """The table of a family."""
    return SCS if family == "feetech-scs" else STS
