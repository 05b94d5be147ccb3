"""In what an emulated P-series servo differs from one of the X series (ROBOTIS e-manual).

Its RAM lies 448 addresses higher, at the same distances. It counts pulses of its own gear from the
middle. Ranges are those of the PM42-010-S260; what the manual leaves open is chosen. The external
ports are not emulated.
"""

from dataclasses import dataclass

NUMBERS = range(2000, 2200)
SHIFT = 448
END = 147  # bytes of the table, in the X series' addresses
MODES = (0, 1, 3, 4, 16)
FURTHEST = 2**31 - 1
GAINS = (76, 78, 80, 82, 84, 88, 90)
VOLTS = (150, 350)  # 0.1 V


@dataclass(frozen=True)
class PModel:
    """`steps`: pulses of a turn. Factory limits: of current [mA], of velocity [0.01 rev/min], of
    acceleration [rev/min^2] and its highest value, and of the position [pulses]."""

    steps: int
    current: int = 1461
    velocity: int = 2600
    acceleration: tuple[int, int] = (10_867, 4_346_756)
    position: int = 262_931


P_MODELS = {
    2000: PModel(607_500),
    2010: PModel(1_003_846, 15_900, 2920, (10_639, 4_255_632), 501_433),
    2020: PModel(1_003_846, position=501_433),
    2100: PModel(526_374),
    2110: PModel(502_834, position=251_000),
    2120: PModel(502_834, position=251_000),
}


@dataclass(frozen=True)
class Units:
    """`steps` of a turn, the count of the straight tail (`middle`), rad/s and rad/s^2 of a count of
    speed and of acceleration; `shift`: by how much the RAM's addresses lie higher than the X
    series'."""

    steps: int = 4096
    middle: int = 2048
    speed: float = 0.02398
    acceleration: float = 0.3745
    shift: int = 0


def units_of(number: int) -> Units:
    """The units of a model."""
    if number not in NUMBERS:
        return Units()
    model = P_MODELS.get(number, PModel(526_374))
    return Units(model.steps, 0, 0.001047198, 0.001745329, SHIFT)


def ranges(model: PModel) -> dict[int, tuple[int, int, int, int]]:
    """Registers by the X series' addresses: bytes, factory value, lowest and highest value that may
    be written."""
    most = model.steps // 2
    ramp, steepest = model.acceleration
    own = {
        8: (1, 3, 0, 9),
        20: (4, 0, -FURTHEST, FURTHEST),
        24: (4, 20, 0, model.velocity),
        32: (2, VOLTS[1], *VOLTS),
        34: (2, VOLTS[0], *VOLTS),
        36: (2, 2009, 0, 2009),
        38: (2, model.current, 0, model.current),
        40: (4, ramp, 0, steepest),
        44: (4, model.velocity, 0, model.velocity),
        48: (4, model.position, -most, most),
        52: (4, -model.position, -most, most),
        63: (1, 58, 0, 255),
        65: (1, 0, 0, 255),
        66: (1, 0, 0, 255),
        67: (1, 0, 0, 255),
        100: (2, 2009, -2009, 2009),
        102: (2, model.current, -model.current, model.current),
        104: (4, model.velocity, -model.velocity, model.velocity),
        108: (4, 0, 0, steepest),
        112: (4, 0, 0, model.velocity),
        116: (4, 0, -FURTHEST, FURTHEST),
    }
    return own | dict.fromkeys(GAINS, (2, 0, 0, 32_767))
