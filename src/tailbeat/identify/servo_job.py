"""`tailbeat identify servo`: fit with several seeds, keep the best, and check it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.datasheet import Datasheet, disagreements
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.intervals import estimates
from tailbeat.identify.naive_servo import Naive, naive_servos
from tailbeat.identify.response import drive_frequency
from tailbeat.identify.search import Fit
from tailbeat.identify.servo import IDEALISED, as_servos, described_servo, gain_reference
from tailbeat.identify.servo_gains import at_edges, contradictions
from tailbeat.identify.servo_search import Progress, ServoConfig, searched
from tailbeat.identify.shaft import Bench, free_run
from tailbeat.identify.space import Parameter, values

Array = NDArray[np.float64]
MODEL = ("kp", "kv", "armature", "damping", "friction", "force_limit", "delay")
SATURATED = 0.9  # fraction of the time at the limit; above it nothing else can be identified


@dataclass(frozen=True)
class Overlay:
    """One recording, and the angles (k,) [rad] of the identified and of the idealised servo. `role`
    is fit or validate."""

    bench: Bench
    role: str
    identified: Array
    idealised: Array

    @property
    def stroke(self) -> tuple[float, float]:
        """Start and end [s] of a stroke: one beat about the widest swing."""
        good = self.bench.good
        time, angle = self.bench.time[good], self.bench.angle[good]
        beat = 1 / drive_frequency(time, angle)
        middle = time[np.argmax(np.abs(angle - np.median(angle)))]
        start = min(max(middle - beat / 2, 0.0), self.bench.time[-1] - beat)
        return float(max(start, 0.0)), float(start + beat)

    def error_deg(self, which: str = "identified") -> Array:
        """Angle error (k,) deg at the good samples."""
        return np.degrees(getattr(self, which) - self.bench.angle)[self.bench.good]

    def rmse_deg(self, which: str = "identified") -> float:
        """Root mean square angle error [deg]."""
        return float(np.sqrt(np.square(self.error_deg(which)).mean()))

    @property
    def mae_deg(self) -> float:
        """Mean absolute angle error [deg]."""
        return float(np.abs(self.error_deg()).mean())


@dataclass(frozen=True)
class LeftOut:
    """A gain or recording that was left out of a fit, and the fit's mean absolute and root mean
    square error on it [deg]."""

    held_out: str
    mae_deg: float
    rmse_deg: float


@dataclass(frozen=True, eq=False)
class ServoFit:
    """The result: one fit per seed, best first, and every recording replayed.

    `servo` has the seven numbers that the twin compiles [SI], at the `gain` register. `seconds` [s]
    is the duration of the search. `left_out` is empty without cross-validation. `naive` has the
    naive predictors, fitted on the same recordings. `contradictions` are recordings that cannot be
    of one servo, or of none; `datasheet` is the one that counted, if any.
    """

    space: tuple[Parameter, ...]
    fits: tuple[Fit, ...]
    overlays: tuple[Overlay, ...]
    servo: dict[str, float]
    gain: float | None
    warnings: tuple[str, ...]
    seconds: float
    left_out: tuple[LeftOut, ...] = ()
    naive: tuple[Naive, ...] = ()
    contradictions: tuple[str, ...] = ()
    datasheet: Datasheet | None = None

    @property
    def to_naive(self) -> float:
        """Ratio of the mean absolute error to the best naive predictor's, on held-out recordings if
        there are any."""
        own = self.mae_deg("validate") or self.mae_deg("fit") or 0.0
        return own / max(min(one.judged_mae_deg for one in self.naive), 1e-9)

    def estimates(self) -> dict[str, Estimate]:
        """Number -> value, unit and 95 % interval; if recordings state gains, kp at `gain`."""
        found = estimates(self.space, self.fits)
        if self.gain is None:
            return found
        scale = found["gain_scale"]
        low, high = (self.gain * edge for edge in scale.interval)
        return {"kp": Estimate(self.gain * scale.value, (low, high), "N m/rad"), **found}

    def mae_deg(self, role: str) -> float | None:
        """Mean absolute error over the recordings of a role, `fit` or `validate` [deg]."""
        errors = [one.mae_deg for one in self.overlays if one.role == role]
        return float(np.mean(errors)) if errors else None


def identify_servo(
    fish: Fish,
    fit: Sequence[Bench],
    validate: Sequence[Bench],
    config: ServoConfig,
    scratch: Path,
    progress: Progress = lambda seed, stage, share, best: None,
) -> ServoFit:
    """Fit on `fit`, and measure errors on both. Interrupted work in `scratch` is resumed. Raises
    BadInput if `fit` is empty or only some recordings state a gain."""
    began = time.monotonic()
    if not fit:
        raise BadInput("--fit is empty; give at least one recording to fit.")
    middle = gain_reference([*fit, *validate])
    if middle is None and config.gain is not None:
        raise BadInput(
            f"--gain {config.gain:g}: no recording states its gain; add a line `# gain: ...` on top"
            f" of each, or leave --gain out."
        )
    gain = None if middle is None else config.gain or gain_reference(fit)
    space, fits = searched(fit, config, scratch, progress)
    baseline = fish.servos.get("idealised", IDEALISED)
    overlays = [
        *_replay(space, fits[0], described_servo(baseline), fit, "fit"),
        *_replay(space, fits[0], described_servo(baseline), validate, "validate"),
    ]
    found = values(space, fits[0].z)
    servo = _compiled_servo(found, gain, fit, overlays)
    sheet = config.datasheet
    warnings = (*_warnings(space, fits[0], fit, sheet), *disagreements(found, sheet))
    return ServoFit(
        space,
        tuple(fits),
        tuple(overlays),
        servo,
        gain,
        warnings,
        seconds=time.monotonic() - began,
        naive=naive_servos(fit, validate),
        contradictions=(*at_edges(space, fits[0].z), *contradictions(space, fits[0].z, fit)),
        datasheet=sheet,
    )


def _replay(
    space: tuple[Parameter, ...],
    fit: Fit,
    baseline: dict[str, Array],
    benches: Sequence[Bench],
    role: str,
) -> list[Overlay]:
    if not benches:
        return []
    identified = free_run(as_servos(space, fit.z[None], benches), benches)
    idealised = free_run(baseline, benches)
    return [
        Overlay(bench, role, a[0], b[0])
        for bench, a, b in zip(benches, identified, idealised, strict=True)
    ]


def _compiled_servo(
    found: dict[str, float],
    gain: float | None,
    fit: Sequence[Bench],
    overlays: Sequence[Overlay],
) -> dict[str, float]:
    """The seven numbers that the twin compiles, at the gain that the fish will run with.

    The engine's friction is one number. It includes the gears' friction at the mean torque that
    they carried while the shaft moved.
    """
    if gain is not None:
        found = {**found, "kp": found["gain_scale"] * gain}
    servo = {name: found[name] for name in MODEL}
    carried = [_carried(found, bench) for bench in fit]
    servo["friction"] += found.get("load_friction", 0.0) * float(np.mean(carried))
    return servo


def _carried(found: dict[str, float], bench: Bench) -> float:
    """Mean torque through the gears while the shaft moved [N m], from the recording."""
    kp = found["gain_scale"] * (bench.gain or 0.0) if "gain_scale" in found else found["kp"]
    good = bench.good
    time, command, angle, enabled = (
        column[good] for column in (bench.time, bench.command, bench.angle, bench.enabled)
    )
    torque = np.minimum(kp * np.abs(command - angle), found["force_limit"])
    speed = np.abs(np.gradient(angle, time))
    moving = (speed > 0.1 * np.quantile(speed, 0.95)) & (enabled > 0.5)
    return float(torque[moving].mean()) if moving.any() else 0.0


def saturation(found: dict[str, float], bench: Bench) -> float:
    """Fraction of the time at which the servo is at its force limit."""
    kp = found["gain_scale"] * (bench.gain or 0.0) if "gain_scale" in found else found["kp"]
    late = np.interp(bench.time - found["delay"], bench.time, bench.command)
    wanted = kp * np.abs(late - bench.angle)
    limited = (wanted > found["force_limit"]) & (bench.enabled > 0.5)
    return float(np.mean(limited[bench.good]))


def _warnings(
    space: tuple[Parameter, ...], best: Fit, fit: Sequence[Bench], sheet: Datasheet | None
) -> list[str]:
    """What the data do not determine, a sentence each."""
    found = values(space, best.z)
    shares = {bench.name: saturation(found, bench) for bench in fit}
    said = [
        f"{name} is at the force limit {100 * share:.0f} % of the time: it does not show gain and"
        f" delay; record smaller or slower commands"
        for name, share in shares.items()
        if share > SATURATED
    ]
    if max(shares.values()) < 0.002:
        said.append(
            "no recording reaches the force limit: "
            + ("its value is the datasheet's" if sheet else "take its value as a lower bound")
            + ", and record larger steps to find it"
        )
    return said
