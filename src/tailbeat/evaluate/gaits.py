"""A grid of commands, each swum to both sides: how fast the fish is, and how tightly it turns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import Generator
from tailbeat.evaluate.steady_swims import Command, Steady, Swimmer, poses, setpoints, steady
from tailbeat.evaluate.trial import Progress

Array = NDArray[np.float64]
TURNS = 1e-3  # rad/s: a swim that turns less goes straight
LOWEST = 0.2  # Hz: beats begin here if the band begins lower
BEATS = 2  # in a burst


@dataclass(frozen=True)
class Grid:
    """Which commands are swum.

    Frequencies: these shares of the band's lower edge `below` it, and `inside` values over the
    band. Amplitudes and centres as shares of the generator's largest. `rests` of bursts in lengths
    of a burst. `seconds` [s] of a swim, and `coast` [s] of a stop, for the paper's fish.
    """

    below: tuple[float, ...] = (0.3, 0.6)
    inside: int = 4
    amplitudes: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4, 1.0)
    centres: tuple[float, ...] = (0.0, 0.5, 1.0)
    rests: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0)
    seconds: float = 60.0
    coast: float = 120.0


@dataclass(frozen=True)
class Gait:
    """A command swum with its centre to the left and to the right; one number for each water.

    `speed`: mean speed of the faster of both [m/s], negative backwards. `radius`: of the wider
    circle [m], infinite if they do not turn to two sides, or not forward. `rate`: of the slower
    turn [rad/s]. NaN where the simulation was lost.
    """

    command: Command
    speed: tuple[float, ...]
    radius: tuple[float, ...]
    rate: tuple[float, ...]


def frequencies(band: tuple[float, float], grid: Grid) -> tuple[tuple[float, ...], Array]:
    """Frequencies [Hz] below the band's lower edge, and in the band."""
    below = tuple(share * band[0] for share in grid.below if band[0] > 0)
    return below, np.geomspace(max(band[0], min(LOWEST, band[1] / 2)), band[1], grid.inside)


def middle(band: tuple[float, float]) -> float:
    """The frequency in the band's middle [Hz]."""
    return float(np.sqrt(max(band[0], LOWEST) * band[1]))


def beats_of(space: Generator, band: tuple[float, float], grid: Grid) -> list[Command]:
    """Every beat about every centre to the left."""
    below, inside = frequencies(band, grid)
    return [
        Command(frequency, share * space.first, centre * space.offset)
        for frequency in (*below, *inside.tolist())
        for share in grid.amplitudes
        for centre in grid.centres
    ]


def bursts_of(space: Generator, band: tuple[float, float], grid: Grid) -> list[Command]:
    """Bursts of full beats in the band's middle, with every pause, about every centre."""
    beat = middle(band)
    burst = BEATS / beat
    return [
        Command(beat, space.first, centre * space.offset, burst, rest * burst)
        for rest in grid.rests
        for centre in grid.centres
    ]


def gaits_of(
    swimmer: Swimmer,
    space: Generator,
    commands: Sequence[Command],
    seconds: float,
    progress: Progress,
) -> tuple[Gait, ...]:
    """Swim every command to both sides for `seconds` [s]."""
    both = list(dict.fromkeys(one for left in commands for one in (left, mirrored(left))))
    pose = poses(swimmer, setpoints(space, both, seconds), progress)
    swum = [steady(each, [one.period for one in both]) for each in pose]
    place = {one: i for i, one in enumerate(both)}
    return tuple(_gait(one, swum, place[one], place[mirrored(one)]) for one in commands)


def mirrored(command: Command) -> Command:
    """The command with its centre on the other side."""
    return replace(command, centre=-command.centre)


def _gait(command: Command, swum: Sequence[Steady], left: int, right: int) -> Gait:
    """Both sides of a command in every water."""
    speed, rate, radius = (
        np.array([[getattr(one, name)[side] for one in swum] for side in (left, right)])
        for name in ("speed", "rate", "radius")
    )
    turns = (rate[0] * rate[1] < 0) & (np.abs(rate) > TURNS).all(axis=0) & (speed > 0).all(axis=0)
    return Gait(
        command,
        tuple(speed.max(axis=0).tolist()),
        tuple(np.where(turns, radius.max(axis=0), np.inf).tolist()),
        tuple(np.abs(rate).min(axis=0).tolist()),
    )
