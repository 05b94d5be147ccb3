"""What a fish can do at all under constant commands of the generator, without a policy.

How slowly it can be steered, how tight its circle is at each speed, how far it goes on when the
tail stops, and how slow it is with pauses between its beats. From this follows which closed paths
any policy can be asked to follow at a fixed speed. Open, still water; several waters of the pool's
ensemble, and the twin if one is given.

Not covered: the second harmonic, commands that change within a beat, loops, zigzags, currents.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tailbeat.control.actions import Generator, generator
from tailbeat.control.measure import Measure
from tailbeat.env.measured import measure_of
from tailbeat.evaluate.closed_paths import PathRow, path_rows, waters_allowing
from tailbeat.evaluate.gaits import Gait, Grid, beats_of, bursts_of, gaits_of, middle
from tailbeat.evaluate.limit_rows import (
    BurstRow,
    CircleRow,
    SlowestRow,
    StopRow,
    burst_rows,
    circles,
    slowest,
    stop_rows,
)
from tailbeat.evaluate.steady_swims import Command, Swimmer
from tailbeat.evaluate.stopping import stops
from tailbeat.evaluate.trial import Progress
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.pool.water import ensemble, fingerprint

TIGHT = 0.6  # m: a steerable beat turns in a circle of this radius, of the paper's fish (chosen)
QUARTER = np.pi / 2  # rad: and turns by so much within the patience for one target (chosen)
GRIDS = {
    "full": Grid(),
    "coarse": Grid((0.5,), 2, (0.1, 0.3, 1.0), (0.0, 1.0), (1.0, 3.0), 30.0, 60.0),
}


@dataclass(frozen=True)
class Place:
    """All swims `where`, in pool or twin: beats without and with pauses."""

    where: str
    gaits: tuple[Gait, ...]
    bursts: tuple[Gait, ...]


@dataclass(frozen=True)
class SwimLimits:
    """What a fish (name) can do in the pool's waters (count, fingerprint), and in the twin (name).

    `band` [Hz] is the fish's. `radius` [m] and `rate` [rad/s] say what counts as steerable. The
    first of the `places` is the pool.
    """

    fish: str
    twin: str | None
    waters: int
    water: str
    band: tuple[float, float]
    radius: float
    rate: float
    slowest: tuple[SlowestRow, ...]
    circles: tuple[CircleRow, ...]
    stops: tuple[StopRow, ...]
    bursts: tuple[BurstRow, ...]
    paths: tuple[PathRow, ...]
    places: tuple[Place, ...]


@dataclass(frozen=True)
class LimitsConfig:
    """Names of the pool's `fish` and of the `twin`; number of `waters`, drawn from `seed`; which
    `grid` of commands."""

    fish: str = "pulley-fish"
    twin: str | None = None
    waters: int = 4
    grid: str = "full"
    seed: int = 0


def limits_of(config: LimitsConfig, progress: Progress) -> SwimLimits:
    """Measure a fish's limits. Raises BadInput."""
    if config.grid not in GRIDS:
        raise BadInput(f"--grid {config.grid!r}: allowed are {', '.join(GRIDS)}.")
    if not 1 <= config.waters <= 100:
        raise BadInput(f"--waters {config.waters}: allowed are 1 to 100.")
    swimmers = [Swimmer(load_fish(config.fish), tuple(ensemble(config.waters, config.seed)))]
    if config.twin is not None:
        swimmers.append(Swimmer(load_fish(config.twin)))
    return limits(swimmers, GRIDS[config.grid], progress)


def limits(swimmers: Sequence[Swimmer], grid: Grid, progress: Progress) -> SwimLimits:
    """Measure what fish can do. The first swims in the pool, and all get its commands. Raises
    BadInput for a fish that cannot beat about a centre."""
    spaces = [space_of(one.fish) for one in swimmers]
    pool, band = swimmers[0], swimmers[0].fish.band
    size = measure_of(pool.fish)
    plan = _Plan(spaces[0], grid, band, size)
    places = [_place(one, plan, progress) for one in swimmers]
    halts = [row for one in swimmers for row in _stops(one, plan, progress)]
    radius, rate = TIGHT * size.reach, QUARTER / size.patience
    return SwimLimits(
        fish=pool.fish.name,
        twin=swimmers[1].fish.name if len(swimmers) > 1 else None,
        waters=pool.count,
        water=fingerprint(pool.waters),
        band=band,
        radius=radius,
        rate=rate,
        slowest=tuple(row for p in places for row in slowest(p.where, p.gaits, band, radius, rate)),
        circles=tuple(row for p in places for row in circles(p.where, p.gaits, band, size.speed)),
        stops=tuple(halts),
        bursts=tuple(row for p in places for row in burst_rows(p.where, p.bursts)),
        paths=tuple(
            row for p in places for row in path_rows(p.where, p.gaits, p.bursts, band, size)
        ),
        places=tuple(places),
    )


def space_of(fish: Fish) -> Generator:
    """The fish's generator, with the band's upper edge as its ceiling and no floor. Raises BadInput
    for a crank."""
    if fish.motor.range is None:
        raise BadInput(
            f"{fish.name}: its motor is a {fish.motor.kind}, which has no centre to beat about;"
            f" give a fish whose motor is a pulley."
        )
    return generator(*fish.motor.range, fish.band[1])


@dataclass(frozen=True)
class _Plan:
    """What is swum everywhere: the pool's fish's generator, band [Hz] and measure, and the grid."""

    space: Generator
    grid: Grid
    band: tuple[float, float]
    size: Measure


def _place(swimmer: Swimmer, plan: _Plan, progress: Progress) -> Place:
    """Swim the whole grid."""
    beats = beats_of(plan.space, plan.band, plan.grid)
    bursts = bursts_of(plan.space, plan.band, plan.grid)
    seconds = plan.grid.seconds * plan.size.time
    found = gaits_of(swimmer, plan.space, [*beats, *bursts], seconds, progress)
    return Place(swimmer.name, found[: len(beats)], found[len(beats) :])


def _stops(swimmer: Swimmer, plan: _Plan, progress: Progress) -> list[StopRow]:
    """Stop from beats of every amplitude in the band's middle, with the tail straight and bent."""
    space, grid = plan.space, plan.grid
    beats = [
        Command(middle(plan.band), share * space.first, 0.0) for share in sorted(grid.amplitudes)
    ]
    times = grid.seconds * plan.size.time, grid.coast * plan.size.time
    rows: list[StopRow] = []
    for tail, centre in (("straight", 0.0), ("bent", space.offset)):
        found = stops(swimmer, space, beats, Command(0.0, 0.0, centre), times, progress)
        rows += stop_rows(swimmer.name, tail, found)
    return rows


# ---- what may be asked of any policy ------------------------------------------------------------


def allowed(limits: SwimLimits, speed: float, radius: float, lowest: float = 0.0) -> bool:
    """Whether any policy can be asked to follow a path whose least radius of curvature is `radius`
    [m], behind a target at `speed` [m/s]: whether the fish can, in every water of the pool, with
    beats of `lowest` [Hz] or more."""
    gaits = [one for one in limits.places[0].gaits if one.command.frequency >= lowest]
    return waters_allowing(gaits, speed, radius) == limits.waters
