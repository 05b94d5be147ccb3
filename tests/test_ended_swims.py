"""A fish whose swim is over is stepped no more, which changes nothing for the others."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.control.policy import decide, load_policy
from tailbeat.env.assess import assess
from tailbeat.env.simulator import TwinSimulator
from tailbeat.env.task import settings_for
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish

FISH, POLICY = load_fish("pulley-fish-pool"), load_policy("pulley-fish-pool-generator")


def test_swims_are_the_same_to_the_bit_when_those_before_them_are_over(monkeypatch):
    settings = settings_for(POLICY.contract)
    moved = []
    advance = TwinSimulator.advance

    def counted(self, setpoint, push):
        before = self.qpos.copy()
        lost = advance(self, setpoint, push)
        moved.append(int((self.qpos != before).any(axis=1).sum()))
        return lost

    def swum():
        moved.clear()
        build = partial(World, FISH, settings)
        return assess(partial(decide, POLICY), build, 6, 3), sum(moved)

    monkeypatch.setattr(TwinSimulator, "advance", counted)
    some, stepped = swum()
    monkeypatch.setattr(TwinSimulator, "keep", lambda self, going: None)
    whole, all_stepped = swum()
    for name in ("reached", "seconds", "way", "nearest", "apart"):
        assert np.array_equal(getattr(some, name), getattr(whole, name)), name
    assert stepped == np.round(some.seconds / 0.02).sum() < all_stepped
