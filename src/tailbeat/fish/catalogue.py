"""Servos by their makers' numbers, and the servo of a description that those numbers suggest.

A geared DC motor at a fixed voltage gives `stall (1 - speed / no_load)` at full duty. So its back
EMF acts as the damping stall / no_load outside the torque limit. A ROBOTIS X-series position loop
sets the duty to gain / 128 counts of PWM per count of error, out of 885 (its e-Manual). That its
fitted gain differs was observed on an XL330 (0.87 N m/rad for 1.2): identify it.
"""

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources

from tailbeat.files import BadInput
from tailbeat.fish.description import Family, Hardware, Servo

COUNTS_PER_RAD = 4096 / (2 * math.pi)
FULL_PWM = 885
TIME_CONSTANT = 0.030  # s, armature over damping; two identified servos have 0.023 and 0.043
DELAY = 0.015  # s: a bus cycle and the firmware, chosen
STALL_SHARE = 0.8  # of the stall current, at which the robot stops; chosen
USUAL_GAIN = 800.0  # for makers whose loop is not published
MAKERS: dict[Family, str] = {
    "dynamixel-x": "ROBOTIS",
    "dynamixel-p": "ROBOTIS",
    "feetech-sts": "Feetech",
    "feetech-scs": "Feetech",
}


def rad_per_s(rpm: float) -> float:
    """A speed of `rpm` [rev/min] in rad/s."""
    return rpm * 2 * math.pi / 60


@dataclass(frozen=True)
class Profile:
    """A servo in a catalogue: `model` as its maker writes it, `voltage_v` [V], `stall_nm` [N m],
    `no_load_rpm` [rev/min] and `stall_a` [A] at that voltage, `mass_g` [g], `gain` of its position
    loop as shipped. `number` is what it reports as its model, 0 for one that the driver cannot
    speak to; `range_v` [V] the supply that it takes, `temperature_c` [deg C] at which it shuts
    down, `current_ma` [mA] of one count, 0 for one that reports a load. `family`: its driver.
    """

    name: str
    model: str
    voltage_v: float
    stall_nm: float
    no_load_rpm: float
    mass_g: float
    gain: float = USUAL_GAIN
    number: int = 0
    range_v: tuple[float, float] = (0.0, 0.0)
    stall_a: float = 0.0
    temperature_c: float = 0.0
    current_ma: float = 0.0
    family: Family = "dynamixel-x"

    @property
    def no_load(self) -> float:
        """No-load speed of the shaft [rad/s]."""
        return rad_per_s(self.no_load_rpm)

    @property
    def torque_per_ampere(self) -> float:
        """Torque at the shaft of an ampere [N m/A]: of a DC motor that of its stall, less what its
        gears take. NaN without a stall current."""
        return self.stall_nm / self.stall_a if self.stall_a else math.nan

    def servo(self) -> Servo:
        """Numbers to start from, before a bench has measured this servo."""
        damping = self.stall_nm / self.no_load
        gain = self.gain if self.family == "dynamixel-x" else USUAL_GAIN
        return Servo(
            kp=self.stall_nm * gain / 128 * COUNTS_PER_RAD / FULL_PWM,
            kv=0.0,
            armature=TIME_CONSTANT * damping,
            damping=damping,
            force_limit=self.stall_nm,
            delay=DELAY,
        )

    def hardware(self) -> Hardware | None:
        """What driver, emulator and safety limits need; None for a servo that the driver cannot
        speak to."""
        if not self.number:
            return None
        return Hardware(
            family=self.family,
            make=MAKERS[self.family],
            model=self.model,
            number=self.number,
            supply=self.voltage_v,
            supply_range=self.range_v,
            current_unit=1e-3 * (self.current_ma or self.stall_a),
            current_limit=round(STALL_SHARE * self.stall_a, 2),
            temperature_limit=self.temperature_c,
            gain=int(self.gain),
        )


@cache
def profiles() -> dict[str, Profile]:
    """Every servo of the catalogue, by name."""
    text = (resources.files("tailbeat.fish") / "servos.toml").read_text("utf-8")
    return {name: Profile(name, **numbers) for name, numbers in tomllib.loads(text).items()}


def by_number(number: int) -> Profile | None:
    """The catalogue's servo that reports this model number; None for one that it lacks."""
    return next((one for one in profiles().values() if number and one.number == number), None)


def profile(name: str) -> Profile:
    """A servo by its name, in any case. Raises BadInput for one that the catalogue lacks."""
    known = profiles()
    if name.lower() not in known:
        raise BadInput(
            f"--servo {name!r}: not in the catalogue ({', '.join(known)}); take one of similar"
            f" torque and speed, and put your servo's numbers into its [servos] table."
        )
    return known[name.lower()]
