"""Report a tail's identification: the JSON report and the fish's fields."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from tailbeat.fish.description import Fish
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


@dataclass(frozen=True)
class TailResult:
    """The result: the fit, the hinges, the slow pull's loop, the ring-down, and all glitches."""

    fit: TailFit
    hinges: Hinges
    loop: Loop | None
    ring: RingDown | None
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
        return found


def combine(
    fish: Fish,
    fit: TailFit,
    loop: Loop | None,
    ring: RingDown | None,
    glitches: Sequence[Glitch] = (),
) -> TailResult:
    """Distribute the measured stiffness over the fish's hinges. `glitches` are those of `loop` and
    `ring`."""
    hinges = hinges_for(fish, fit.k_eff.value, fit.c_eff.value)
    return TailResult(fit, hinges, loop, ring, (*fit.glitches, *glitches))


def as_report(found: TailResult) -> dict[str, Any]:
    """The JSON report."""
    fit, hinges = found.fit, found.hinges
    said = verdict((), (), fit.contradictions)
    return {
        "verdict": list(said.sentences),
        "trusted": said.trusted,
        **{name: as_row(getattr(fit, name)) for name in NUMBERS},
        "joint_stiffness": list(hinges.stiffness),
        "joint_damping": [k * _damping_time(fit) for k in hinges.stiffness],
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


def _damping_time(fit: TailFit) -> float:
    return max(fit.c_eff.value, 0.0) / fit.k_eff.value


def toml_values(found: TailResult, recordings: Sequence[str]) -> dict[str, dict[str, Any] | str]:
    """Field -> {value, unit, interval, source} for `store.write_identified`."""
    fit, source = found.fit, f"identified on {', '.join(recordings)}"
    k = fit.k_eff.value

    def _entry(value: float, unit: str, interval: Sequence[float]) -> dict[str, Any]:
        edges = [float(f"{max(edge, 0.0):.5g}") for edge in interval]
        number = float(f"{max(value, 0.0):.6g}")
        return {"value": number, "unit": unit, "interval": edges, "source": source}

    damping = [edge / k for edge in fit.c_eff.interval]
    written: dict[str, dict[str, Any] | str] = {
        "tail.k_eff": _entry(k, "N m/rad", fit.k_eff.interval),
        "tail.damping_time": _entry(fit.c_eff.value / k, "s", damping),
        "tail.friction": _entry(fit.coulomb.value, "N m", fit.coulomb.interval),
        "tail.stiffness_scale": _entry(1.0, "1", (1.0, 1.0)),
    }
    for i, stiffness in enumerate(found.hinges.stiffness):
        edges = [stiffness * edge / k for edge in fit.k_eff.interval]
        written[f"tail.links.{i}.stiffness"] = _entry(stiffness, "N m/rad", edges)
    return written


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
