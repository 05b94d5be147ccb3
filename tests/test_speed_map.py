"""Speeds of plant and twin over frequency, also where their servos have different names."""

import pytest

from tailbeat.evaluate import speed_map
from tailbeat.fish.store import load_fish

TWIN = load_fish("pulley-fish-pool")


@pytest.mark.thorough
def test_a_pool_s_fish_swims_with_its_own_servo_where_the_twin_s_name_is_not_known(monkeypatch):
    """A lab names its servo as it likes; the identified fish calls it `identified`."""
    monkeypatch.setattr(speed_map, "FREQUENCIES", (2.0,))
    monkeypatch.setattr(speed_map, "SHAFT_SPEEDS", (4.0,))
    fish = load_fish("pulley-fish")
    own = fish.servos[fish.servo]
    lab = fish.model_copy(update={"servo": "bench", "servos": {"bench": own}})
    (named,) = speed_map.speed_map(lab, [TWIN.servo], TWIN).rows
    (known,) = speed_map.speed_map(fish, [TWIN.servo], TWIN).rows
    assert named.plant == known.plant and named.twin == known.twin
    assert named.twin == pytest.approx(named.plant, rel=0.15)  # and the twin is this fish's
    strong = own.model_copy(update={"kp": 20 * own.kp})
    other = lab.model_copy(update={"servos": {"bench": strong}})
    (moved,) = speed_map.speed_map(other, [TWIN.servo], TWIN).rows
    assert abs(moved.plant - named.plant) > 0.01
