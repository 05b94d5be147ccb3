"""Disturbed swims compared with undisturbed ones to the same targets, in the same waters."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tailbeat.control.measure import Measure
from tailbeat.env.task import Scene
from tailbeat.evaluate.rates import ConditionResult, against
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.trial import Condition, Pool
from tailbeat.pool.plant import Surroundings, stirred

# Sizes are chosen for the paper's fish: about its speed and turning rate, and pokes with a finger.
BACKWARD = -0.2  # m/s
SPIN = 2.0  # rad/s
POKES, POKE, TWIST, POKED = 4, 1.0, 0.05, 0.2  # number, N, N m, s
STIRRED = 0.03  # m/s rms
CALM = "disturb none"


def conditions(pool: Pool) -> list[Condition]:
    """Targets within +-120 deg and 0.5-2.5 m: undisturbed, released moving, poked, stirred."""
    m = pool.measure
    near, far = 0.5 * m.reach, 2.5 * m.reach
    scene = grid(pool.fish, pool.count, pool.seed + 1, near, far, float(np.radians(120)))
    numbers = [[pool.seed, i] for i in range(pool.count)]
    poked = tuple(_pokes(np.random.default_rng(number), m) for number in numbers)
    moved = tuple(stirred(1000 * pool.seed + i, STIRRED * m.speed) for i in range(pool.count))
    return [
        pool.condition(CALM, scene),
        pool.condition("disturb backward", _released(scene, BACKWARD * m.speed, 0.0)),
        pool.condition("disturb spinning", _released(scene, 0.0, SPIN / m.time)),
        pool.condition("disturb poked", scene, around=poked),
        pool.condition("disturb stirred", scene, around=moved),
    ]


def _released(scene: Scene, speed: float, spin: float) -> Scene:
    """Release fish that move along their heading [m/s] and turn [rad/s], every second one in the
    other direction."""
    heading = scene.start[:, 2]
    side = np.where(np.arange(len(heading)) % 2, -1.0, 1.0)
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), spin * side], axis=1)
    return replace(scene, velocity=velocity)


def _pokes(rng: np.random.Generator, m: Measure) -> Surroundings:
    angle = rng.uniform(-np.pi, np.pi, POKES)
    twist = TWIST * m.push * m.size  # a force at an arm
    when, twists = m.time * rng.uniform(0.5, 8.0, POKES), twist * rng.choice([-1.0, 1.0], POKES)
    poke = POKE * m.push
    rows = np.stack(
        [when, np.full(POKES, POKED), poke * np.cos(angle), poke * np.sin(angle), twists], axis=1
    )
    return Surroundings(pokes=tuple(tuple(row) for row in rows.tolist()))


def numbers(by_condition: Mapping[str, Runs]) -> tuple[ConditionResult, ...]:
    """Results per condition: success rates, and their change by the disturbance on the same
    targets."""
    return against(by_condition[CALM], by_condition)
