"""How one robot is built, from the logs of its own swims: servo, tail and water of its twin.

The twin repeats pieces of the swims: it gets the setpoints that the servo got, and its shaft and
path are compared with what encoder and camera saw. A bench tells more, so every number has a prior:
the description, as wrong as labs are. Where the twin lacks something, such as slack tendons, the
numbers are those with which it swims most like the robot. All of this is ours; tests/test_logs.py
counts how often the intervals hold.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import COEFFICIENTS, Fish
from tailbeat.fish.store import value_at, with_values
from tailbeat.identify import log_pieces
from tailbeat.identify.doubt import by_swims
from tailbeat.identify.intervals import intervals
from tailbeat.identify.log_pieces import Piece
from tailbeat.identify.polish import polish
from tailbeat.identify.search import Fit
from tailbeat.identify.space import WIDE_STEP, Parameter, bounds, cost, covariance, sensitivity
from tailbeat.identify.space import values as values_at
from tailbeat.identify.swim_columns import Logged

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
HELD_OUT = 4  # every fourth piece is not fitted
ROUNDS, ITERATIONS = 3, 5  # of polish, between which the residuals are scaled anew (chosen)
ROUGH = 8.0  # scale of the residuals in the first round
TOGETHER = 8.0  # samples that err alike, chosen: a beat's, in which the twin is off one way
WIDE = 3.0  # factor on the intervals, set on ten made labs; others test it
TOLD = 0.5  # of the prior's spread: what the swims must leave of it to tell a number


@dataclass(frozen=True)
class Number:
    """A number that is fitted, by its prior, and the fields of the fish that it multiplies, or is
    added to if it is no factor."""

    prior: Parameter
    fields: tuple[str, ...] = ()


@dataclass(frozen=True)
class Told:
    """A number of the robot: its value with its 95 % interval, whether the swims tell it, and the
    fields of the fish that it changes."""

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    told: bool
    fields: tuple[str, ...]


@dataclass(frozen=True)
class Misfit:
    """Rms errors in pieces that were not fitted: of the shaft [rad], of the place [m]."""

    shaft: float
    place: float


@dataclass(frozen=True)
class Built:
    """The robot's twin: the fields of the fish that changed, in SI, and the numbers behind them;
    how many pieces were `fitted`; in the `held_out` ones the errors of the new twin, and of the
    naive predictor: the fish as described, with only what lies beside it fitted."""

    fields: dict[str, float]
    numbers: tuple[Told, ...]
    described: Misfit
    refitted: Misfit
    fitted: int
    held_out: int

    @property
    def better(self) -> bool:
        """Whether the new twin is nearer in the held-out pieces, shaft and place together."""
        old, new = (
            (one.shaft / log_pieces.ANGLE) ** 2 + (one.place / log_pieces.POSITION) ** 2
            for one in (self.described, self.refitted)
        )
        return new < old


def _factor(name: str, spread: float, *fields: str) -> Number:
    return Number(Parameter(name, "1", 0.2, 5.0, 1.0, spread), fields)


def _aside(name: str, unit: str, most: float, spread: float, prior: float = 0.0) -> Number:
    """A number beside the fish: of its sensors, or of the pool."""
    low = 0.0 if name == "late" else -most
    return Number(Parameter(name, unit, low, most, prior, spread, log=False))


def numbers(fish: Fish) -> tuple[Number, ...]:
    """What is fitted of a fish. The spreads are about twice the everyday sizes of messy labs."""
    servo, limit = f"servos.{fish.servo}", fish.servos[fish.servo].force_limit
    stated = () if fish.tail.k_eff is None else ("tail.k_eff",)
    friction = Parameter("shaft friction", "N m", 0.0, 0.6 * limit, 0.0, 0.08 * limit, log=False)
    return (
        _factor("servo gain", 0.3, f"{servo}.kp", f"{servo}.kv"),
        _factor("servo damping", 0.3, f"{servo}.damping"),
        _factor("servo torque", 0.3, f"{servo}.force_limit"),
        Number(friction, (f"{servo}.friction",)),
        _factor("tail stiffness", 0.3, "tail.stiffness_scale", *stated),
        *(
            _factor(f"water, {zone}", 0.2, *(f"zones.{zone}.{one}" for one in COEFFICIENTS))
            for zone in fish.zones
        ),
        _aside("setpoint", "rad", 0.6, 0.1),
        _aside("encoder", "rad", 0.6, 0.1),
        _aside("late", "s", 0.15, 0.03, prior=0.02),
        _aside("current x", "m/s", 0.5, 0.05),
        _aside("current y", "m/s", 0.5, 0.05),
    )


def changed(fish: Fish, found: dict[str, float]) -> dict[str, float]:
    """Fields of the fish, in SI, with the numbers that were found, and maybe others."""
    given = [(one, found[one.prior.path]) for one in numbers(fish) if one.prior.path in found]
    return {
        field: value_at(fish, field) * value if one.prior.log else value_at(fish, field) + value
        for one, value in given
        for field in one.fields
    }


def fit_logs(
    fish: Fish, swims: Sequence[Logged], progress: Progress = lambda what, done, of: None
) -> Built:
    """Fit a fish to logged swims of one robot, whose tag, shaft and gyro are corrected already.
    Raises BadInput for swims that are too short, or a fish whose motor turns without end."""
    if fish.motor.range is None:
        raise BadInput(
            f"{fish.name}: its motor is a {fish.motor.kind}, which no robot here drives; give the"
            f" fish with a pulley whose robot wrote the logs."
        )
    cut = log_pieces.pieces(swims)
    held = cut[HELD_OUT - 1 :: HELD_OUT]
    fitted = [one for i, one in enumerate(cut) if i % HELD_OUT != HELD_OUT - 1]
    naive = [one for one in numbers(fish) if not one.fields]
    as_told, _ = _best(fish, fitted, naive, lambda turn: progress("fit", turn, 2 * ROUNDS))
    whole = numbers(fish)
    found, spans = _best(fish, fitted, whole, lambda t: progress("fit", ROUNDS + t, 2 * ROUNDS))
    told = [
        Told(p.path, p.unit, found[p.path], spans[p.path], _tells(p, spans[p.path]), one.fields)
        for one in whole
        for p in [one.prior]
        if one.fields
    ]
    fields = changed(fish, found)
    old, new = _misfit(fish, held, as_told), _misfit(with_values(fish, fields), held, found)
    return Built(fields, tuple(told), old, new, len(fitted), len(held))


def _tells(prior: Parameter, span: tuple[float, float]) -> bool:
    """Whether an interval is narrow enough, and not at the end of the range."""
    low, high = (prior.to_z(max(end, 1e-9) if prior.log else end) for end in span)
    return bool(high - low < 2 * 1.96 * TOLD)


def _best(
    fish: Fish, cut: Sequence[Piece], own: Sequence[Number], tell: Callable[[int], None]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """The best numbers, and their 95 % intervals, which count pieces. Twins err alike for a beat,
    so residuals are scaled until `TOGETHER` of them count as one."""
    space = tuple(one.prior for one in own)
    edges, compare = bounds(space), partial(_residuals, fish, cut, space)
    z, noise = np.clip(np.zeros(len(space)), *edges), ROUGH
    for turn in range(ROUNDS):
        tell(turn)
        z = polish(partial(_scaled, compare, noise), space, z, ITERATIONS)
        noise = float(np.sqrt(TOGETHER * np.mean(np.square(compare(z[None])[0]))))
    tell(ROUNDS)
    found, slope = sensitivity(partial(_scaled, compare, noise), z, step=WIDE_STEP, edges=edges)
    fit = Fit(0, z, float(cost(found, z)), found, slope, covariance(slope))
    doubt = by_swims(fit, np.repeat(np.arange(len(cut)), found.size // len(cut))).fit
    wide = replace(doubt, covariance=WIDE**2 * doubt.covariance)
    spans = intervals(space, [wide], freedom=max(len(cut) - 1, 3))
    return values_at(space, z), {p.path: span for p, span in zip(space, spans, strict=True)}


def _scaled(compare: Callable[[Array], Array], noise: float, z: Array) -> Array:
    return compare(z) / noise


def _residuals(fish: Fish, cut: Sequence[Piece], space: tuple[Parameter, ...], z: Array) -> Array:
    """Residuals (n, r) of candidates (n, p): those of all pieces, one after the other."""
    found = [values_at(space, row) for row in z]
    fishes = [with_values(fish, changed(fish, one)) for one in found]
    done = log_pieces.repeat(fishes, cut, found)
    rows = [
        [log_pieces.residuals(fish, one, s, own) for one, s in zip(cut, swum, strict=True)]
        for swum, own in zip(done, found, strict=True)
    ]
    return np.array(rows).reshape(len(z), -1)


def _misfit(fish: Fish, cut: Sequence[Piece], found: dict[str, float]) -> Misfit:
    """Rms errors of a fish in some pieces; infinite if its twin diverges in one."""
    done = log_pieces.repeat([fish], cut, [found])[0]
    if any(one.diverged for one in done):
        return Misfit(np.inf, np.inf)
    both = [log_pieces.errors(fish, one, s, found) for one, s in zip(cut, done, strict=True)]
    shaft, path = (np.concatenate(side) for side in zip(*both, strict=True))
    return Misfit(
        float(np.sqrt(np.mean(shaft**2))), float(np.sqrt(np.mean(np.sum(path[:, :2] ** 2, axis=1))))
    )
