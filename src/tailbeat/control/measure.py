"""The measure of a fish: how large its task is, over that of the paper's fish.

A task in metres and seconds fits one fish. The paper's numbers are multiplied by four ratios, so
that a fish of any size gets targets that it can turn to and reach, and an arrival that its camera
can see. The ratios are in the policy's contract, so the robot needs nothing else.
"""

import math
from dataclasses import dataclass

ARRIVAL, NEAR = 0.05, 0.2  # m from a target: it is reached; the paper's wider circle
PATIENCE = 30.0  # s for one target
LENGTH = 0.54  # m, from nose to fin of the paper's fish as described
SPEED, CIRCLE = 0.45, 0.39  # m/s, m: best speed and tightest circle of its quick swims
MASS = 1.218  # kg, as described
LEAST = 0.25  # of the size: reach, so that the nearest target is not within the arrival
STEPS = 10  # preferred numbers in a decade (ISO 3, R10)


@dataclass(frozen=True)
class Measure:
    """Ratios to the paper's fish."""

    size: float = 1.0
    """Length: of the arrival, and of all that is measured along the body."""
    reach: float = 1.0
    """Distances of targets: the larger of how far it swims in a time and how tightly it turns."""
    speed: float = 1.0
    """Speed: of currents and moving targets."""
    mass: float = 1.0
    """Mass: of pushes, whose impulse goes with mass and speed."""

    @property
    def time(self) -> float:
        """Times to swim a distance."""
        return self.reach / self.speed

    @property
    def push(self) -> float:
        """Forces of pushes that last as long on every fish."""
        return self.mass * self.speed

    @property
    def arrival(self) -> float:
        """Distance at which a target is reached [m]; 5 cm for the paper's fish (paper)."""
        return ARRIVAL * self.size

    @property
    def near(self) -> float:
        """The paper's wider circle about a target [m]; 20 cm for its fish (paper)."""
        return NEAR * self.size

    @property
    def patience(self) -> float:
        """Time for one target [s]; 30 s for the paper's fish (chosen)."""
        return PATIENCE * self.time


PAPER = Measure()  # of the paper's fish


def centimetres(distance: float) -> str:
    """A distance [m] as people say it."""
    return f"{100 * distance:.2g} cm"


def preferred(ratio: float) -> float:
    """The nearest number of the series R10: steps of 26 %. So a small change of a fish's speed
    does not change its task, and the paper's numbers come out for the paper's fish."""
    return float(f"{10 ** (round(STEPS * math.log10(ratio)) / STEPS):.3g}")


def arrival_of(length: float) -> float:
    """Distance at which a fish of a length [m] has reached a target [m], where only its description
    is known."""
    return ARRIVAL * preferred(length / LENGTH)


def measure(length: float, speed: float, circle: float, mass: float) -> Measure:
    """The measure of a fish from its length [m], best speed [m/s], tightest circle's radius [m] and
    mass [kg], all above 0."""
    pace = preferred(speed / SPEED)
    size = preferred(length / LENGTH)
    reach = max(preferred(circle / CIRCLE), pace, LEAST * size)
    return Measure(size, reach, pace, preferred(mass / MASS))
