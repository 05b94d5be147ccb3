"""Which recording to make next: the one from which a chosen prediction would gain most a minute.

A prediction is in doubt for two reasons: the numbers of the water, which swims tell (`next_swim`),
and those of tail and servo, which test benches tell (`next_bench`). The two doubts are independent
here. A prediction is of a swim that is commanded, so it depends on the servo too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import intervals, load_fish
from tailbeat.identify import next_swim
from tailbeat.identify.bands import Drawn, swim_all
from tailbeat.identify.next_bench import (
    BenchRecording,
    Intervals,
    Moved,
    bench_recordings,
    doubted,
    left,
    one_of,
)
from tailbeat.identify.next_swim import SwimRecording, as_played, spread_after
from tailbeat.identify.posterior import Posterior, fishes, needed
from tailbeat.recording import Recording

Array = NDArray[np.float64]
Offer = SwimRecording | BenchRecording
# Goals: swims by the end of their names, and quantities of `UNITS` that count.
GOALS: dict[str, tuple[str, tuple[str, ...]]] = {
    "speed": ("", ("speed",)),
    "turning": ("turn", ("heading", "turn_rate")),
    "reach": ("wander", ("distance", "heading")),
}


@dataclass(frozen=True)
class Advice:
    """What to `record`, of a `kind`: `gain` is the fraction by which the goal's band shrinks on top
    of those before it in the list, `minutes` the lab time with what it needs before."""

    record: str
    kind: str
    gain: float
    minutes: float

    @property
    def gain_per_minute(self) -> float:
        """Gain over lab time [1/min]."""
        return self.gain / self.minutes


@dataclass(frozen=True, eq=False)
class Doubts:
    """What makes a goal's band wide: what each of n draws of the water predicts (n, g), and by how
    much one deviation of each of q doubts of the benches moves it (q, g)."""

    water: Array
    benches: Array

    def left(self, made: Sequence[Offer]) -> float:
        """Root mean square deviation of the goal after these recordings."""
        shown = [one.shown for one in made if isinstance(one, SwimRecording)]
        told = [one.told for one in made if isinstance(one, BenchRecording)]
        return float(np.sqrt(spread_after(self.water, shown) ** 2 + left(self.benches, told)))


def advise_on(fish: str, goal: str, count: int = 3) -> list[Advice]:
    """`advise` for a fish's file with its posterior beside it. Raises BadInput without one."""
    if count < 1:
        raise BadInput(f"--count {count}: give 1 or more.")
    return advise(load_fish(fish), needed(fish), goal, count, known=intervals(fish))


def advise(
    fish: Fish,
    posterior: Posterior,
    goal: str,
    count: int = 3,
    draws: int = 100,
    known: Intervals | None = None,
) -> list[Advice]:
    """The `count` recordings that shrink the goal's band most per minute, each given those before
    it: swims that were not fitted yet and, with what is `known` of tail and servo, conditions of
    the tail and servo commands. Raises BadInput for an unknown goal, or another fish's
    posterior."""
    if goal not in GOALS:
        raise BadInput(f"--goal {goal}: allowed are {', '.join(GOALS)}.")
    kind, quantities = GOALS[goal]
    commands, drawn = next_swim.commands(fish), fishes(fish, posterior, draws)
    made = as_played(commands, fish)
    swum = dict(zip(made, swim_all(drawn, list(made.values())), strict=True))
    own = next_swim.of_kind(swum, fish, kind)
    goals = [swum[name] for name in own]
    moved = doubted(fish, known or {})
    away = moved_goals(fish, moved, {name: commands[name] for name in own}, goals, quantities)
    swims = {
        name: next_swim.recording_of(one, posterior.discrepancy, name in own)
        for name, one in swum.items()
        if name not in posterior.fitted
    }
    benches = bench_recordings(fish, moved) if moved else {}
    return choose(Doubts(next_swim.scaled(goals, quantities), away), {**swims, **benches}, count)


def moved_goals(
    fish: Fish,
    moved: Moved,
    commands: Mapping[str, Recording],
    goals: Sequence[Drawn],
    quantities: Sequence[str],
) -> Array:
    """By how much each moved fish (q, g) differs in the goals when it swims the commands, over the
    goals' sizes; 0 where one tells nothing."""

    def away(one: Fish) -> Array:
        swum = swim_all([one], list(as_played(commands, one).values()))
        both = [
            Drawn(new.run, new.measured, np.vstack([old.centre, new.predicted]))
            for old, new in zip(goals, swum, strict=True)
        ]
        found = next_swim.scaled(both, quantities)
        return np.nan_to_num(found[1] - found[0], posinf=0.0, neginf=0.0)

    rows = [one_of([away(one) for one in each], np.argmax) for each in moved.values()]
    return np.array(rows)


def choose(doubts: Doubts, offers: Mapping[str, Offer], count: int) -> list[Advice]:
    """The best recordings one after the other."""
    made: list[Offer] = []
    found: list[Advice] = []
    open_to = dict(offers)
    for _ in range(min(count, len(open_to))):
        before = doubts.left(made)
        rated = [
            Advice(name, one.kind, 1 - doubts.left([*made, one]) / before, one.minutes)
            for name, one in open_to.items()
        ]
        best = max(rated, key=lambda one: one.gain_per_minute)
        found.append(best)
        made.append(open_to.pop(best.record))
    return found
