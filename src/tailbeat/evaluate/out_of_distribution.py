"""Conditions that a policy was not trained on, compared with the same swims as trained."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tailbeat.control.actions import Generator
from tailbeat.control.observation import bearing
from tailbeat.env.sensors import SensorModel
from tailbeat.evaluate.rates import ConditionResult, against
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.scenes import grid, moving
from tailbeat.evaluate.trial import Condition, Pool
from tailbeat.fish.description import Servo

SCALES = (1.5, 2.7, 5.3)  # wrong scales of the paper's policy
SPEEDS = (0.05, 0.10)  # m/s of moving targets, of the paper's fish
WEAK = 0.6  # factor on the servo's gain and torque
LOST_FRAMES = (0.3, 0.6)  # fraction of frames without a tag
SECONDS = 30.0
PREFIX = "out of distribution: "
AS_TRAINED = f"{PREFIX}as trained"


def conditions(pool: Pool) -> list[Condition]:
    """Rear, far and moving targets, wrong scales, a weak servo, lost frames."""
    m, side = pool.measure, float(np.radians(120))
    spans = [(m.reach * a, m.reach * b) for a, b in ((2.5, 4.0), (0.5, 2.5))]
    far = grid(pool.fish, pool.count, pool.seed + 2, *spans[0], side)
    scene = grid(pool.fish, pool.count, pool.seed + 2, *spans[1], side)
    rear = grid(pool.fish, pool.count, pool.seed + 2, *spans[1], np.pi)
    behind = replace(rear, target=_behind(rear.target, rear.start))
    found = [pool.condition(AS_TRAINED, scene), pool.condition(f"{PREFIX}rear", behind)]
    found.append(pool.condition(f"{PREFIX}far", far))
    for speed in SPEEDS:
        gone = moving(scene, speed * m.speed, SECONDS * m.time, pool.seed)
        found.append(pool.condition(f"{PREFIX}target {speed:g} m/s", gone))
    if isinstance(pool.actions, Generator):
        found += [
            pool.condition(f"{PREFIX}scales x{by:g}", scene, actions=_scaled(pool.actions, by))
            for by in SCALES
        ]
    found.append(pool.condition(f"{PREFIX}weak servo", scene, servo=_weak(pool)))
    for share in LOST_FRAMES:
        blind = replace(SensorModel(), dropped=share)
        found.append(pool.condition(f"{PREFIX}frames lost {share:g}", scene, sensors=blind))
    return found


def _behind(target: Any, start: Any) -> Any:
    """Move every target into the rear 120 deg: bearing b becomes 180 minus b / 3, on the same
    side."""
    offset = target[:, 0] - start[:, :2]
    seen = bearing(start, target[:, 0])
    rear = np.sign(seen) * (np.pi - np.abs(seen) / 3) + start[:, 2]
    far = np.hypot(offset[:, 0], offset[:, 1])
    return (start[:, :2] + far[:, None] * np.stack([np.cos(rear), np.sin(rear)], axis=1))[:, None]


def _scaled(space: Generator, by: float) -> Generator:
    """The generator with wrong scales, as on one robot; the ceiling of the frequency does not
    change."""
    return replace(
        space, offset=by * space.offset, first=by * space.first, second=by * space.second
    )


def _weak(pool: Pool) -> Servo:
    own = pool.fish.servos[pool.fish.servo]
    return own.model_copy(update={"kp": WEAK * own.kp, "force_limit": WEAK * own.force_limit})


def numbers(by_condition: Mapping[str, Runs]) -> tuple[ConditionResult, ...]:
    """Results per condition: success rates, and their difference to the swims as trained (rear and
    far have other targets)."""
    return against(by_condition[AS_TRAINED], by_condition)
