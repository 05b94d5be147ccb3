"""Does an identified fish hold its own step? If not, the step that does is written with it."""

import tomllib
from dataclasses import dataclass
from typing import Any

from tailbeat.files import BadInput
from tailbeat.fish import convergence
from tailbeat.fish.convergence import Deviation
from tailbeat.fish.description import Fish
from tailbeat.fish.store import Entry, fish_path

OURS = "chosen after the identification"
SOURCE = f"{OURS}: the cheapest step that holds, since the described one errs too much"


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
    """Whether the step in a fish's file was chosen by an identification, not by its user."""
    content = tomllib.loads(fish_path(fish).read_text(encoding="utf-8-sig"))
    step = content.get("simulation", {}).get("step")
    return isinstance(step, dict) and str(step.get("source", "")).startswith(OURS)


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


def toml_values(found: Held) -> dict[str, Entry | str]:
    """Fields of the step for `store.write_identified`; none if it stays."""
    if not found.changed:
        return {}
    step: Entry = {"value": found.step.simulation.step, "unit": "s", "source": SOURCE}
    return {"simulation.step": step, "simulation.integrator": found.step.simulation.integrator}


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
