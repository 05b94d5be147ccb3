"""Report a tail's identification: the JSON report and the fish's fields."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from tailbeat.fish.description import Fish
from tailbeat.fish.store import Entry
from tailbeat.identify.decay import Loop, RingDown
from tailbeat.identify.estimate import as_row
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.glitches import Glitch
from tailbeat.identify.hinges import Hinges, hinges_for
from tailbeat.identify.response import Condition
from tailbeat.identify.tail import TailFit, frequencies
from tailbeat.identify.trust import verdict

NUMBERS = ("k_eff", "i_eff", "c_eff", "coulomb")
MISSED = 0.02  # relative difference of the compiled shaft's stiffness that draws a warning
# The same of a slow pull's, both ways, beyond which it is of another tail; chosen: plastics are
# softer when they are pulled slowly.
STATIC = 0.3
STRANGE = 30.0  # times the described inertia, chosen: 1000 is a unit, 3 may be a wrong mass
HEAVY = 0.3  # the same of its inertia; air and large strokes make up to 0.15


@dataclass(frozen=True)
class TailResult:
    """The result: the fit, the hinges, the slow pull's loop, the ring-down, and all glitches.

    `damping_time` [s] and `friction` [N m] are what the fish gets: the measured numbers, or the
    described ones where the data decide nothing.
    """

    fit: TailFit
    hinges: Hinges
    loop: Loop | None
    ring: RingDown | None
    damping_time: float
    friction: float
    glitches: tuple[Glitch, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """What the data do not determine, or the description contradicts."""
        found = list(self.fit.warnings)
        measured, compiled = self.fit.k_eff.value, self.hinges.k_compiled
        if abs(compiled - measured) > MISSED * measured:
            found.append(
                f"the compiled tail has {compiled:.3g} N m/rad at the shaft, measured are"
                f" {measured:.3g}: the tendons stretch, or arms and guides are wrong in the fish"
            )
        inertia = self.fit.i_eff
        if inertia.above_zero and abs(inertia.value / self.hinges.i_compiled - 1) > HEAVY:
            found.append(
                f"the tail's inertia at the shaft is {inertia.value:.3g} kg m^2, the description"
                f" gives {self.hinges.i_compiled:.3g}: masses of links or fin are wrong in the fish"
            )
        return found

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Recordings that are not of one tail. Friction makes a slow pull stiffer one way and
        softer the other, so both ways tell. Or of no such tail: an inertia that is another one
        altogether is a torque in another unit."""
        own, described = self.fit.i_eff, self.hinges.i_compiled
        if own.above_zero and not 1 / STRANGE < own.value / described < STRANGE:
            return (
                *self.fit.contradictions,
                f"the tail's inertia at the shaft is {own.value:.3g} kg m^2, the description gives"
                f" {described:.3g}: check that column torque_nm is in N m",
            )
        if self.loop is None:
            return self.fit.contradictions
        k, ways = self.fit.k_eff.value, (self.loop.loading, self.loop.unloading)
        if (1 - STATIC) * k <= max(ways) and min(ways) <= (1 + STATIC) * k:
            return self.fit.contradictions
        return (
            *self.fit.contradictions,
            f"the stiffness is {k:.3g} N m/rad in the sweep, and {ways[0]:.3g} and {ways[1]:.3g} in"
            f" the slow pull, loading and unloading: they are not of one tail, or one torque is"
            f" wrong; record the wrong one again",
        )


def combine(
    fish: Fish,
    fit: TailFit,
    loop: Loop | None,
    ring: RingDown | None,
    glitches: Sequence[Glitch] = (),
) -> TailResult:
    """Distribute the measured stiffness over the fish's hinges. `glitches` are those of `loop` and
    `ring`."""
    k = fit.k_eff.value
    damping = fit.c_eff.value / k if fit.c_eff.above_zero else fish.tail.damping_time
    friction = fit.coulomb.value if fit.coulomb.above_zero else fish.tail.friction
    hinges = hinges_for(fish, k, damping * k)
    return TailResult(fit, hinges, loop, ring, damping, friction, (*fit.glitches, *glitches))


def as_report(found: TailResult) -> dict[str, Any]:
    """The JSON report."""
    fit, hinges = found.fit, found.hinges
    said = verdict((), fit.spoilt, found.contradictions)
    return {
        "verdict": list(said.sentences),
        "trusted": said.trusted,
        **{name: as_row(getattr(fit, name)) for name in NUMBERS},
        "next_mode": None if fit.mode is None else as_row(fit.mode),
        "stroke": None if fit.bend is None else as_row(fit.bend),
        "joint_stiffness": list(hinges.stiffness),
        "joint_damping": [k * found.damping_time for k in hinges.stiffness],
        "joint_pattern": hinges.pattern,
        "arms": list(hinges.arms),
        "radius": hinges.radius,
        "k_eff_compiled": hinges.k_compiled,
        "i_eff_compiled": hinges.i_compiled,
        "frequencies": frequencies(fit.conditions),
        "excess_scatter": {"re": fit.excess_re, "im": fit.excess_im},
        "conditions": [_condition(c) for c in fit.conditions],
        "static": None if found.loop is None else _static(found.loop, fit.k_eff.value),
        "ring_down": None if found.ring is None else _ring(found.ring),
        "warnings": found.warnings,
        "glitches": as_rows(found.glitches),
        "tailbeat": version("tailbeat"),
    }


def _condition(condition: Condition) -> dict[str, Any]:
    response = condition.response
    row = {k: v for k, v in asdict(condition).items() if k not in ("response", "deviation")}
    return {**row, "re": response.real, "im": response.imag, "deviation": condition.deviation}


def _static(loop: Loop, k_eff: float) -> dict[str, Any]:
    """A static test's numbers, and the relative error of its stiffness while loading."""
    return {**asdict(loop), "bias": loop.loading / k_eff - 1}


def _ring(ring: RingDown) -> dict[str, Any]:
    return {
        "recording": ring.recording,
        "column": ring.column,
        "natural_frequency": as_row(ring.natural_frequency),
        "damping_ratio": as_row(ring.damping_ratio),
        "start": ring.start,
        "end": ring.end,
    }


def toml_values(found: TailResult, recordings: Sequence[str]) -> dict[str, Entry | str]:
    """Fields for `store.write_identified`."""
    fit, source = found.fit, f"identified on {', '.join(recordings)}"
    k = fit.k_eff.value

    def _entry(value: float, unit: str, interval: Sequence[float]) -> Entry:
        edges = [float(f"{max(edge, 0.0):.5g}") for edge in interval]
        number = float(f"{max(value, 0.0):.6g}")
        return {"value": number, "unit": unit, "interval": edges, "source": source}

    damping = [edge / k for edge in fit.c_eff.interval]
    written: dict[str, Entry | str] = {
        "tail.k_eff": _entry(k, "N m/rad", fit.k_eff.interval),
        "tail.damping_time": _kept(_entry(found.damping_time, "s", damping), fit.c_eff.above_zero),
        "tail.friction": _kept(
            _entry(found.friction, "N m", fit.coulomb.interval), fit.coulomb.above_zero
        ),
        "tail.stiffness_scale": _entry(1.0, "1", (1.0, 1.0)),
    }
    for i, stiffness in enumerate(found.hinges.stiffness):
        edges = [stiffness * edge / k for edge in fit.k_eff.interval]
        written[f"tail.links.{i}.stiffness"] = _entry(stiffness, "N m/rad", edges)
    return written


def _kept(entry: Entry, measured: bool) -> Entry:
    """An entry of a number that stays as it was described where it was not measured."""
    source = entry["source"]
    said = source if measured else f"as described: {source}, which do not decide it"
    return {**entry, "source": said}


def heading(found: TailResult) -> str:
    """The first lines of an identified fish."""
    fit = found.fit
    return "\n".join(
        [
            "Tail identified by `tailbeat identify tail`; the report beside it has the rest.",
            f"k_eff {fit.k_eff.value:.4g} N m/rad, 95 % {fit.k_eff.interval[0]:.4g}"
            f"-{fit.k_eff.interval[1]:.4g}, from {len(fit.conditions)} conditions at"
            f" {len(frequencies(fit.conditions))} frequencies; hinges by {found.hinges.pattern}.",
            f"tailbeat {version('tailbeat')}.",
        ]
    )
