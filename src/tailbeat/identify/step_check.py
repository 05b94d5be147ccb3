"""Does an identified fish hold its own step? If not, the step that does is written with it."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish import convergence
from tailbeat.fish.convergence import Deviation
from tailbeat.fish.description import Fish, Simulation
from tailbeat.fish.store import Entry, fish_path
from tailbeat.identify.fluid import fluid_space, residual_function
from tailbeat.identify.runs import Run

SOURCE = f"{convergence.OURS}: the cheapest step that holds with the identified numbers"
ALIKE = 1.0  # rms by which residuals of two steps may differ: what a recording errs by (chosen)
TRIED = 4  # candidates that both swim: the prior's centre, and draws about it


@dataclass(frozen=True)
class Held:
    """The step that an identified fish gets; `changed` if it is not the one it had, which erred by
    `before` of the way (infinite: it diverged)."""

    step: Deviation
    changed: bool
    before: float

    @property
    def warnings(self) -> list[str]:
        """What was changed, or could not be mended, in a sentence."""
        if self.before < convergence.ALLOWED:
            return []
        how = "diverged" if self.before == float("inf") else f"erred by {100 * self.before:.0f} %"
        if not self.changed:
            return [
                f"the described step {how} of the way at full stroke with the identified numbers,"
                f" and shorter ones hardly less: such swims depend on the smallest disturbance"
            ]
        now = self.step.simulation
        return [
            f"the described step {how} at full stroke with the identified numbers; the fish was"
            f" written with {1e3 * now.step:g} ms, {now.integrator}"
        ]


def is_ours(fish: str) -> bool:
    """Whether the step in a fish's file was chosen by a sketch or an identification, not by its
    user."""
    content = tomllib.loads(fish_path(fish).read_text(encoding="utf-8-sig"))
    step = content.get("simulation", {}).get("step")
    return isinstance(step, dict) and str(step.get("source", "")).startswith(convergence.OURS)


def held(fish: Fish, ours: bool = False) -> Held:
    """The step that holds for an identified fish at the largest stroke and rate that its motor can
    be commanded: its own if it does. A step of `ours` was chosen when other numbers were still
    guesses, so it is chosen anew. Raises BadInput if the fish diverges at every step."""
    own = () if ours else (fish.simulation,)
    best = convergence.choose(fish, (*own, *convergence.CHOICES))
    if best.error == float("inf"):
        raise BadInput(
            f"{fish.name}: with the identified numbers it diverges at every step down to"
            f" {1e3 * convergence.CHOICES[-1].step:g} ms; check masses and stiffnesses of the links"
            f" and the recordings' units."
        )
    changed = best.simulation != fish.simulation
    return Held(best, changed, convergence.deviation(fish).error if changed else best.error)


def for_swims(fish: Fish, fit: Sequence[Run], zones: int) -> Fish:
    """The fish with the cheapest step that repeats recorded swims as its own does: a robot's beats
    in water are gentler than the largest commands, and a search takes ten thousands of swims."""
    space, some = fluid_space(fish, zones), fit[::3]
    z = np.random.default_rng(0).normal(0.0, 0.5, (TRIED, len(space)))
    z[0] = 0.0
    own = residual_function(fish, some, space)(z)
    for simulation in takewhile(lambda one: one != fish.simulation, convergence.CHOICES):
        cheap = fish.model_copy(update={"simulation": simulation})
        with np.errstate(invalid="ignore"):  # both diverged
            away = np.mean((residual_function(cheap, some, space)(z) - own) ** 2)
        if away < ALIKE**2:  # never if one diverged
            return cheap
    return fish


def toml_values(found: Held) -> dict[str, Entry | str]:
    """Fields of the step for `store.write_identified`; none if it stays."""
    return entries(found.step.simulation) if found.changed else {}


def entries(simulation: Simulation) -> dict[str, Entry | str]:
    """Fields of a step of ours."""
    step: Entry = {"value": simulation.step, "unit": "s", "source": SOURCE}
    return {"simulation.step": step, "simulation.integrator": simulation.integrator}


def as_row(found: Held) -> dict[str, Any]:
    """The JSON of the step."""
    now = found.step
    error = None if now.error == float("inf") else now.error
    return {
        "seconds_per_step": now.simulation.step,
        "integrator": now.simulation.integrator,
        "error_of_the_way": error,
        "changed": found.changed,
        "warnings": found.warnings,
    }
