"""The robot's decisions are the environment's, to the bit."""

from copy import deepcopy

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from policies import POLICIES
from tailbeat.control.policy import decide, load_policy
from tailbeat.control.runner import Readings, begin, steer
from tailbeat.env.task import Settings, as_seen
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish

FISH = load_fish("pulley-fish-pool")
# One of each action space and version of the contract.
KINDS = ("follow", "generator", "direct", "filtered", "signal", "reach")


@pytest.mark.parametrize(
    "name",
    [
        one
        if one.removeprefix("pulley-fish-pool-") in KINDS
        else pytest.param(one, marks=pytest.mark.thorough)
        for one in POLICIES
    ],
)
def test_a_swim_recorded_in_the_environment_is_replayed_to_the_bit(name, monkeypatch):
    """Noise, drops and delays on: the readings of 500 steps give the same 500 setpoints."""
    policy = load_policy(POLICIES[name])
    contract = policy.contract
    settings = as_seen(Settings(contract.actions, measure=contract.measure), contract)
    world = World(FISH, settings, [5])
    kept, observe_ = [], world._observe

    def keep(readings, *rest):
        kept.append(deepcopy(readings))  # some are views that the next step writes to
        return observe_(readings, *rest)

    monkeypatch.setattr(world, "_observe", keep)
    seen, sent = world.reset(), []
    for _ in range(500):
        done = world.step(np.asarray(decide(policy, seen), float))
        seen = done.observation
        sent.append(float(world.simulator.ctrl[0, 0]))
    course = begin(policy)
    for readings, setpoint in zip(kept, sent, strict=False):
        own = Readings(
            float(readings.motor_angle[0]),
            float(readings.motor_velocity[0]),
            float(readings.yaw_rate[0]),
            readings.frames[0],
        )
        course, decision = steer(policy, course, own)
        assert decision.setpoint == setpoint
    assert np.ptp(sent) > 0.5
