"""Commands that move the fish as policies do: launches, stops, slow strokes, turns, wandering,
sprints and dashes.

Steady beats from rest (`protocol.fluid_runs`) lack most of a policy's motion: its generator's
frequency goes to zero, its centre so far aside that half of each stroke is cut off, and the beat is
not steady. On its way to a target it beats near the band's end, and the fish is then twice as fast.
There are three of each kind, or a multiple, so that holding out every third swim holds out some of
each.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.proportions import LENGTH
from tailbeat.identify.launch import KEY
from tailbeat.identify.protocol import RATE, ServoLimits, largest
from tailbeat.recording import Recording

Array = NDArray[np.float64]
BEGIN = "begin"  # in the metadata: where in the pool a swim begins, `end` (default) or `middle`
SECONDS = 8.0
FASTEST = 1.5  # shaft speeds reach this multiple of the protocol's limit, as a policy's do
FULL = 5.0  # the same of sprints and dashes: the servo moves as fast as it can
LAG = 0.1  # s, time constant with which frequency, stroke and centre follow their targets


@dataclass(frozen=True)
class Beat:
    """A beat of `seconds` [s]: `frequency` [Hz], `stroke` as a fraction of the largest that the
    limits allow, `centre` [rad]."""

    seconds: float
    frequency: float = 0.0
    stroke: float = 0.0
    centre: float = 0.0


def manoeuvres(fish: Fish, limit: ServoLimits, first: int = 13) -> dict[str, Recording]:
    """Command recordings by name, numbered from `first` in the order of their kinds."""
    low, high = fish.band
    middle = float(np.sqrt(low * high))
    short = min(length_of(fish) / LENGTH, 1.0)  # a longer fish has no larger pool
    kinds = [
        *(("launch", _launched(limit, short * v, b)) for v, b in _launches(low, middle, high)),
        *(("brake", played(limit, one)) for one in _stops(low, middle, high)),
        *(("slow", played(limit, [Beat(SECONDS, *one)])) for one in SLOW),
        *(("turn", played(limit, [Beat(SECONDS, *one)])) for one in _turns(low, middle, high)),
        *(("wander", _wandered(fast(limit), (0.0, high), seed)) for seed in range(6)),
        *(("sprint", played(fast(limit, FULL), [one])) for one in _sprints(high)),
        *(
            ("dash", _wandered(fast(limit, FULL), (0.6 * high, high), seed))
            for seed in range(6, 12)
        ),
    ]
    made = {}
    for number, (kind, (command, launch)) in enumerate(kinds, start=first):
        name = f"fluid-{number:02d}-{kind}"
        made[name] = _recording(name, command, limit, launch, "end" if launch else "middle")
    return made


ASIDE = 0.73  # of the largest angle: at 70 deg and more the centres are those below
# Largest centre of a wandering swim, over the largest angle: a policy's, about which it cannot beat
# freely (`control.actions.Generator`). With 0.8 rad of 1.4, a twin swam a policy's turns up to 12 %
# too slowly.
TURNED = 0.95
SLOW = ((0.5, 1.0, 0.0), (0.3, 0.5, 0.6), (0.7, 0.8, -0.3))  # Hz, fraction of the stroke, rad


def _launches(low: float, middle: float, high: float) -> list[tuple[float, Beat]]:
    """Surge of each launch of the paper's fish [m/s], and the beat after it."""
    return [
        (-0.1, Beat(SECONDS, 0.75 * middle, 0.9)),
        (-0.25, Beat(SECONDS, 1.25 * middle, 0.9)),
        (-0.2, Beat(SECONDS, 1.2 * low, 0.8)),
        (-0.05, Beat(SECONDS, 0.85 * high, 0.9)),
        (0.35, Beat(SECONDS)),
        (-0.3, Beat(SECONDS, middle, 0.9)),
        (0.3, Beat(SECONDS, 0.5, 0.6, 0.2)),
        (-0.15, Beat(SECONDS, 0.9 * middle, 0.5, 0.3)),
        (-0.12, Beat(SECONDS, 0.65 * high, 0.7)),
    ]


def _stops(low: float, middle: float, high: float) -> list[list[Beat]]:
    """Starts and stops: beat, stop, beat again."""
    return [
        [Beat(3, middle, 1.0), Beat(2), Beat(3, 1.3 * low, 0.8)],
        [Beat(3, 1.3 * low, 1.0), Beat(2, 0, 0, 0.8), Beat(3, middle, 0.6, -0.2)],
        [Beat(3, 0.75 * high, 0.9), Beat(2, 0, 0, -0.6), Beat(3, 0.75 * middle, 1.0)],
    ]


def _turns(low: float, middle: float, high: float) -> list[tuple[float, float, float]]:
    """Turns on the spot: frequency [Hz], stroke as a fraction, centre [rad]."""
    return [(0.75 * middle, 0.6, 0.8), (1.25 * middle, 0.6, -0.8), (low, 0.5, -0.6)]


def _sprints(high: float) -> list[Beat]:
    """The fastest swims: the largest strokes near the band's end, one of them turning."""
    return [
        Beat(SECONDS, 0.75 * high, 1.0),
        Beat(SECONDS, 0.9 * high, 1.0, 0.15),
        Beat(SECONDS, 0.97 * high, 0.9),
    ]


def fast(limit: ServoLimits, times: float = FASTEST) -> ServoLimits:
    """The limits with a shaft speed of `times` as much."""
    return ServoLimits(limit.angle, limit.centre, times * limit.speed)


def _launched(limit: ServoLimits, surge: float, beat: Beat) -> tuple[Array, float]:
    return played(limit, [beat])[0], surge


def played(limit: ServoLimits, beats: list[Beat]) -> tuple[Array, float]:
    """Command (k,) [rad] about the range's middle of beats one after the other, whose strokes and
    centres follow with `LAG`; and the surge of its launch [m/s], none."""
    inside = [replace(b, centre=_centre(limit, b.centre)) for b in beats]
    rows = [
        [b.frequency, b.stroke * _largest(limit, b), b.centre]
        for b in inside
        for _ in range(int(b.seconds * RATE))
    ]
    return _swung(np.array(rows)), 0.0


def _centre(limit: ServoLimits, wanted: float) -> float:
    """A centre [rad] that leaves room for a beat, however narrow the motor's range."""
    most = ASIDE * limit.angle
    return min(max(wanted, -most), most)


def _largest(limit: ServoLimits, beat: Beat) -> float:
    """Largest stroke [rad] about the beat's centre that respects both limits; 0 at 0 Hz."""
    room = limit.angle - abs(beat.centre)
    return min(largest(limit, beat.frequency), room) if beat.frequency else 0.0


def _wandered(limit: ServoLimits, band: tuple[float, float], seed: int) -> tuple[Array, float]:
    return wandering(limit, band, 1.25 * SECONDS, np.random.default_rng(seed)), 0.0


def wandering(
    limit: ServoLimits, band: tuple[float, float], seconds: float, rng: np.random.Generator
) -> Array:
    """Command (k,) [rad] about the range's middle, of `seconds` or a little more: random frequency
    in the `band` [Hz], stroke and centre, new ones every 0.3 to 1.5 s. Strokes need no room about
    their centres: what leaves the motor's range is to be cut off, as a policy's setpoints are."""
    low, high = band
    rows: list[list[float]] = []
    while len(rows) < seconds * RATE:
        frequency = low + (high - low) * rng.uniform() ** 1.5
        aside = TURNED * limit.angle * rng.uniform(-1, 1)
        lasts, stroke = rng.uniform(0.3, 1.5), rng.uniform(0.1, 1.0)
        rows += [[frequency, stroke * largest(limit, frequency), aside]] * int(lasts * RATE)
    return _swung(np.array(rows))


def _swung(wanted: Array) -> Array:
    """Command (k,) [rad] of wanted frequency, stroke and centre (k, 3), each lagging by `LAG`."""
    keep, now, phase = np.exp(-1 / RATE / LAG), np.zeros(3), 0.0
    command = np.empty(len(wanted))
    for k, goal in enumerate(wanted):
        now = goal + (now - goal) * keep
        phase += 2 * np.pi * now[0] / RATE
        command[k] = now[2] + now[1] * np.sin(phase)
    return command


def _recording(
    name: str, command: Array, limit: ServoLimits, launch: float, begin: str
) -> Recording:
    inside = np.clip(command, -limit.angle, limit.angle) + limit.centre
    meta = {"purpose": name.split("-", 2)[2], "rate_hz": f"{RATE:g}", BEGIN: begin}
    if launch:
        meta[KEY] = f"{launch:g} 0 0"
    time = np.arange(inside.size) / RATE
    return Recording(name, time, {"command_rad": inside}, meta)
