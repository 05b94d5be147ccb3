"""Stiffness, inertia and damping of the tail at the shaft, from driven oscillation in air.

tau = k theta + c theta' + I theta'' + F sign(theta') gives, at the drive frequency,
H = T / Theta = (k - I w^2) + j (c w + 4 F / (pi A)). Friction acts along the velocity, so it is
only in Im H; its Coulomb part falls with the amplitude A (describing function). Paper: tail
identification; the split of Im H by amplitude is ours.

Two more terms of Re H are fitted where the data show them (ours). A tail of several hinges is one
spring and one inertia only far below its next mode (the shaft held, at w_1): of the modes' sum
G_n w^4 / (w_n^2 - w^2), G_n > 0 (Craig and Bampton 1968), the first term J w^4 is taken off. And
tendons on bent hinges stiffen with the stroke: S A^2 is added. k is that of small strokes. The
hinges' damping is in proportion to their stiffness, so the mode scales it too: c w (1 + J w^4 / k).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from tailbeat.files import BadInput
from tailbeat.identify.clean import clean_tail
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.glitches import Glitch
from tailbeat.identify.response import Condition, measure, split
from tailbeat.identify.trust import share_left_out
from tailbeat.recording import Recording

Array = NDArray[np.float64]
DIFFERENT = 0.1  # fraction by which two recordings' stiffnesses may differ, chosen
UNITS = {"k": "N m/rad", "i": "kg m^2", "mode": "kg m^2 s^2", "bend": "N m/rad^3"}
ALWAYS = ("k", "i")  # of these terms
SAME_FREQUENCY = 0.05  # relative distance below which two conditions count as one frequency


@dataclass(frozen=True)
class TailFit:
    """k_eff [N m/rad], i_eff [kg m^2], c_eff [N m s/rad], coulomb [N m], all at the shaft.

    `excess_re` and `excess_im` [N m/rad] are the scatter of the conditions about the lines beyond
    their own deviations: if it is large, the four numbers do not describe the tail well. `glitches`
    lists what was left out, `contradictions` recordings of different tails. `mode` J [kg m^2 s^2]
    and `bend` S [N m/rad^3] are of the next mode and of the stroke; None: not seen. `spoilt` has
    the fraction of each recording's samples that are glitches.
    """

    conditions: tuple[Condition, ...]
    k_eff: Estimate
    i_eff: Estimate
    c_eff: Estimate
    coulomb: Estimate
    excess_re: float
    excess_im: float
    warnings: tuple[str, ...]
    glitches: tuple[Glitch, ...] = ()
    contradictions: tuple[str, ...] = ()
    mode: Estimate | None = None
    bend: Estimate | None = None
    spoilt: tuple[tuple[str, float], ...] = ()

    def stiffness(self, square: Array) -> Array:
        """Re H [N m/rad] of small strokes at squared frequencies [rad^2/s^2]."""
        bent = 0.0 if self.mode is None else self.mode.value
        return np.asarray(self.k_eff.value - self.i_eff.value * square - bent * square**2)

    def drag(self, omega: Array) -> Array:
        """Im H [N m/rad] without friction at frequencies [rad/s]."""
        return np.asarray(self.c_eff.value * omega * _seen(omega, self.k_eff, self.mode))


def identify_tail(recordings: Sequence[Recording]) -> TailFit:
    """Fit the four numbers to every condition of the recordings.

    Each recording needs `time_s`, `angle_rad` and `torque_nm`: the torque that turns the shaft
    towards larger angles. Time may start again with each `condition`. Raises BadInput if a
    recording cannot be used, if all conditions have one frequency, or if torque and angle have
    opposite signs.
    """
    cleaned = [clean_tail(recording) for recording in recordings]
    found = [measure(*part) for recording, _ in cleaned for part in split(recording)]
    if not found:
        raise BadInput("no drive condition; give at least one recording of a sweep.")
    _check_frequencies(found)
    omega, amplitude = (np.array([getattr(c, n) for c in found]) for n in ("omega", "amplitude"))
    response = np.array([c.response for c in found])
    deviation = np.array([c.deviation for c in found])
    (k, i, mode, bend), spare_re = _stiffness(found, response.real, deviation)
    if k.value <= 0:
        raise BadInput(
            f"{found[0].recording}: the stiffness is {k.value:.3g} N m/rad, so torque and angle"
            f" have opposite signs; torque_nm must turn the shaft towards larger angles."
        )
    drag = np.stack([omega * _seen(omega, k, mode), 4 / (np.pi * amplitude)], 1)
    (c, f), spare_im = line(drag, response.imag, deviation, ("N m s/rad", "N m"))
    warnings = _warnings(found, i, c, f)
    glitches = tuple(glitch for _, listed in cleaned for glitch in listed)
    spoilt = tuple(
        (one.name, share_left_out(listed, one.time.size))
        for one, (_, listed) in zip(recordings, cleaned, strict=True)
    )
    against = tuple(_contradictions(found))
    said = tuple(warnings), glitches, against
    return TailFit(tuple(found), k, i, c, f, spare_re, spare_im, *said, mode, bend, spoilt)


def _stiffness(
    found: Sequence[Condition], real: Array, deviation: Array
) -> tuple[tuple[Estimate, Estimate, Estimate | None, Estimate | None], float]:
    """k, I and, where their intervals lie above zero, J of the next mode and S of the stroke."""
    square = np.array([c.omega**2 for c in found])
    strokes = np.array([c.amplitude for c in found])
    terms = {"k": np.ones_like(square), "i": -square}
    if len(frequencies(found)) > 3:
        terms["mode"] = -(square**2)
    if strokes.max() > 1.5 * strokes.min():
        terms["bend"] = strokes**2
    if len(found) > len(terms):
        values, _ = _named(terms, real, deviation)
        terms = {name: terms[name] for name in terms if name in ALWAYS or values[name].above_zero}
    else:
        terms = {name: terms[name] for name in ALWAYS}
    values, spare = _named(terms, real, deviation)
    return (values["k"], values["i"], values.get("mode"), values.get("bend")), spare


def _named(
    terms: Mapping[str, Array], real: Array, deviation: Array
) -> tuple[dict[str, Estimate], float]:
    basis = np.stack([*terms.values()], 1)
    found, spare = line(basis, real, deviation, [UNITS[name] for name in terms])
    return dict(zip(terms, found, strict=True)), spare


def _seen(omega: Array, stiffness: Estimate, mode: Estimate | None) -> Array:
    """The hinges' stiffness and damping as the shaft sees them, over those of a slow pull."""
    bent = 0.0 if mode is None else mode.value
    return np.asarray(1 + bent * omega**4 / stiffness.value)


def _contradictions(conditions: Sequence[Condition]) -> list[str]:
    """Recordings whose stiffnesses cannot be of one tail: a sentence for the worst pair."""
    found: dict[str, Estimate] = {}
    for name in sorted({c.recording for c in conditions}):
        own = [c for c in conditions if c.recording == name]
        if len(frequencies(own)) > 1:
            omega = np.array([c.omega for c in own])
            basis = np.stack([np.ones_like(omega), -(omega**2)], 1)
            real = np.array([c.response.real for c in own])
            (found[name], _), _ = line(basis, real, np.array([c.deviation for c in own]))
    if len(found) < 2:
        return []
    low = min(found, key=lambda name: found[name].value)
    high = max(found, key=lambda name: found[name].value)
    soft, stiff = found[low], found[high]
    apart = stiff.value - soft.value > DIFFERENT * soft.value
    if not (apart and stiff.interval[0] > soft.interval[1]):
        return []
    return [
        f"the stiffness is {soft.value:.3g} N m/rad in {low} and {stiff.value:.3g} in {high}: they"
        f" are not of one tail, or one torque is wrong; fit each alone, or record again"
    ]


def line(
    basis: Array, measured: Array, deviation: Array, units: Sequence[str] = ("1", "1")
) -> tuple[tuple[Estimate, ...], float]:
    """Weighted fit of p numbers to `measured` (n,) with `basis` (n, p), and the conditions' scatter
    beyond their own deviations.

    This excess makes chi-square per degree of freedom one (Mandel and Paule 1982). So a few
    conditions that seem very exact do not determine the line alone.
    """
    freedom = len(measured) - basis.shape[1]
    excess = _excess(basis, measured, deviation) if freedom > 0 else 0.0
    weight = 1 / (deviation**2 + excess**2)
    inverse = np.linalg.pinv(basis.T @ (weight[:, None] * basis))
    value = inverse @ (basis.T @ (weight * measured))
    quantile = stats.t.ppf(0.975, freedom) if freedom > 0 else stats.norm.ppf(0.975)
    reach = quantile * np.sqrt(np.diag(inverse))
    return tuple(
        Estimate(float(v), (float(v - r), float(v + r)), unit)
        for v, r, unit in zip(value, reach, units, strict=True)
    ), excess


def _excess(basis: Array, measured: Array, deviation: Array) -> float:
    freedom = len(measured) - basis.shape[1]

    def surplus(excess: float) -> float:
        root = np.sqrt(deviation**2 + excess**2)
        fit, *_ = np.linalg.lstsq(basis / root[:, None], measured / root, rcond=None)
        return float(np.square((measured - basis @ fit) / root).sum()) - freedom

    if surplus(0.0) <= 0:
        return 0.0
    return float(brentq(surplus, 0.0, 10 * np.ptp(measured) + 1e-12))


def frequencies(conditions: Sequence[Condition]) -> list[float]:
    """Distinct drive frequencies [Hz], ascending."""
    found: list[float] = []
    for frequency in sorted(c.frequency for c in conditions):
        if not found or frequency > found[-1] * (1 + SAME_FREQUENCY):
            found.append(frequency)
    return found


def _check_frequencies(conditions: Sequence[Condition]) -> None:
    distinct = frequencies(conditions)
    if len(distinct) < 2:
        raise BadInput(
            f"{conditions[0].recording}: every condition is at {distinct[0]:.3g} Hz; record at"
            f" least two frequencies, to separate stiffness and inertia."
        )


def _warnings(
    conditions: Sequence[Condition], inertia: Estimate, damping: Estimate, coulomb: Estimate
) -> list[str]:
    """What the data do not determine, a sentence each."""
    found = []
    amplitudes = np.array([c.amplitude for c in conditions])
    if amplitudes.max() < 1.5 * amplitudes.min():
        found.append(
            "all strokes are alike: Coulomb friction cannot be separated from other damping that"
            " does not grow with frequency; repeat at half the stroke"
        )
    speed = amplitudes * np.array([c.omega for c in conditions])
    if speed.max() < 1.5 * speed.min():
        found.append(
            "stroke times frequency never changes: viscous damping and Coulomb friction cannot be"
            " separated; record other strokes"
        )
    for name, estimate in (("inertia", inertia), ("damping", damping), ("friction", coulomb)):
        if estimate.interval[0] <= 0 <= estimate.interval[1]:
            found.append(f"the {name}'s interval includes zero: these data do not determine it")
        elif estimate.value < 0:
            found.append(
                f"the {name} is negative: check the signs of torque and angle, and whether both"
                f" were sampled at the same instant"
            )
    return found
