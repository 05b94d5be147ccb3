"""What a robot compares of its own signals while it swims: a table of checks, and their bounds."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from tailbeat.control.expected import Limits
from tailbeat.control.load import OBEYED, PULL
from tailbeat.control.measure import Measure

TIMES = 3  # looks in a row in which a check must be broken (chosen)
SAME = 15  # equal poses in a row, a quarter of a second: a camera's noise never repeats (chosen)
ASIDE = math.radians(70)  # between course and heading; 60 in 20 minutes of tours (chosen)
WANDER = 5.0  # m within a second that a target may go to and fro: a hand that drags it (chosen)
# rad/s that a gyro may be off beyond its data sheet: twice an everyday lab's. A policy stands far
# more (`tailbeat margins`), and a fish that held for it would swim in no everyday lab (chosen).
BIAS = 0.2
# Share of the stroke's lower bound: servos of everyday labs are weaker by a fifth, fade by a tenth
# and have friction. Beating far to one side such a servo made 0.42 of the stroke, where the bound
# is 0.75 (chosen; an encoder that shows 0.3 is still told).
WEAKER = 0.5
# Factors of the upper bounds of stroke and recoil: everyday labs, whose servos are stronger and
# tails softer, had 1.25 and 1.40 in 100 minutes, where the bounds are 1.23 and 1.25 (chosen).
STRONGER, LIVELIER = 1.08, 1.15
# Stroke over the robot's own before, of which one look is enough: in 40 minutes of everyday labs no
# window of 2 s had less than 0.656 (chosen from these); one in 140 unseen minutes had 0.63.
WEAKENED = 0.65


@dataclass(frozen=True)
class Check:
    """A comparison of the robot's signals: the statistic of `Signs` or of `control.load`, when it
    is broken, what the operator reads (`{x}`: the value), whether the robot holds or only says so,
    and in how many looks in a row it must be broken."""

    sign: str
    broken: Callable[[float, Limits, Measure], bool]
    text: str
    holds: bool = True
    times: int = TIMES


# In order: the first broken one is said. A NaN breaks none.
CHECKS = (
    Check("same", lambda x, lim, m: x >= SAME,
          "{x:.0f} poses in a row are exactly equal: the tracker hangs; restart it"),
    Check("wander", lambda x, lim, m: x > WANDER * m.reach,
          "the target jumps: {x:.1f} m to and fro in a second; check its tag"),
    Check("stroke", lambda x, lim, m: x < WEAKER * lim.stroke_low,
          "the shaft moves {x:.0%} of its stroke: check servo and encoder"),
    Check("stroke", lambda x, lim, m: x > STRONGER * lim.stroke_high,
          "the shaft moves {x:.0%} of its stroke: its load is missing; check horn and tendons"),
    Check("obeyed", lambda x, lim, m: x < OBEYED,
          "the servo obeys {x:.0%} of its setpoints: check servo, horn and encoder"),
    Check("left", lambda x, lim, m: x < PULL,
          "the left tendon pulls by {x:.0%} of what it should: check tendons and horn"),
    Check("right", lambda x, lim, m: x < PULL,
          "the right tendon pulls by {x:.0%} of what it should: check tendons and horn"),
    Check("weakening", lambda x, lim, m: x < WEAKENED,
          "the shaft moves {x:.0%} of what it moved before: check servo and tendons", times=1),
    Check("turning", lambda x, lim, m: abs(x) > lim.turning + BIAS,
          "IMU and camera differ by {x:.2f} rad/s in the fish's turning"),
    Check("recoil", lambda x, lim, m: not lim.recoil_low <= x <= LIVELIER * lim.recoil_high,
          "the body answers its tail by {x:.0%}: check tendons and IMU; is it held?"),
    Check("progress", lambda x, lim, m: x < lim.progress_low,
          "the tail beats and the fish stays where it is; is it held?"),
    Check("course", lambda x, lim, m: abs(x) > ASIDE,
          "the fish swims {x:.1f} rad off its heading: its tag is turned, or the picture mirrored"),
    Check("drifting", lambda x, lim, m: abs(x) > lim.drifting,
          "the camera turns by {x:.3f} rad/s against the IMU: check that it is fixed; a cold IMU"
          " drifts too", holds=False),
)  # fmt: skip
