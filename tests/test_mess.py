"""The messy pool: nothing wrong changes nothing, and each nuisance does what it says.

Every check is against the formula or a balance of forces, not against a recorded number, except the
fingerprint of the frozen sizes.
"""

from dataclasses import replace

import numpy as np
import pytest

from support import complaint

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.benchmarks import messy
from tailbeat.control.actions import Generator
from tailbeat.env import errors, randomize
from tailbeat.env.errors import Errors
from tailbeat.env.sensors import SensorModel, quiet
from tailbeat.env.task import Settings, check_settings
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.pool import mess
from tailbeat.pool.dynamics import FADING
from tailbeat.pool.plant import Surroundings, at_rest, build_plant, step_plant
from tailbeat.pool.protocols import record_fluid
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water
from tailbeat.pool.wear import Wear
from tailbeat.recording import Recording

FISH = load_fish("pulley-fish-pool")
SOFT = load_fish("pulley-fish")  # its tendons are springs
SPRINGS = {"stiffness": 2e4, "damping": 20.0, "two_way": True}
BOTH_WAYS = SOFT.model_copy(update={"tendons": SOFT.tendons.model_copy(update=SPRINGS)})
STILL = Settings(sensors=quiet(), physics=randomize.none())
NOISY = replace(STILL, sensors=SensorModel())
CALM, NEW = (Surroundings(),), (Wear(),)


def played(command, wear=NEW, around=CALM, fish=FISH, every=10):
    """Swim commands (n, steps) open loop."""
    plant = build_plant(fish, around=around, wear=wear)
    return step_plant(plant, at_rest(plant), np.atleast_2d(command), every)


def beats(seconds=2.0, stroke=0.4, frequency=1.5, centre=0.0):
    time = np.arange(0, seconds, 0.002)
    return centre + stroke * np.sin(2 * np.pi * frequency * time)


def world(wrong=(), settings=STILL, seeds=(3,), around=CALM):
    simulator = PoolSimulator(FISH, [Water()] * len(seeds), around)
    return World(FISH, settings, list(seeds), simulator=simulator, wrong=wrong)


def observed(one, steps=60):
    """Observations and frames (steps, n, ...) under the same random actions."""
    one.reset()
    rng, seen, frames = np.random.default_rng(0), [], []
    for _ in range(steps):
        done = one.step(np.tile(rng.uniform(-1, 1, (1, 6)), (one.count, 1)))
        seen.append(done.observation)
        frames.append(done.frames.copy())
    return np.array(seen), np.array(frames)


# ---- nothing wrong ------------------------------------------------------------------------------


def test_a_lab_without_mess_swims_bit_for_bit_like_the_clean_pool():
    lab = mess.draw(mess.level("clean"), [0, 0])
    assert lab == mess.Lab() and lab.wear == Wear() and lab.errors == errors.NONE
    assert mess.in_lab(lab, Water(), CALM[0]) == (Water(), CALM[0])
    clean, same = world(settings=NOISY), world([errors.NONE], NOISY)
    for first, second in zip(observed(clean), observed(same), strict=True):
        assert np.array_equal(first, second)


def test_the_sizes_are_frozen_and_those_of_the_audit_are_its_own():
    """Whoever changes a size or a level changes what all results in messy pools mean."""
    assert mess.fingerprint() == "2b1a2c6b20c9"
    audit = {"horn": 5, "tag askew": 5, "tag ahead": 20, "tag sideways": 10, "gyro bias": 0.1,
             "hidden": 60, "slack": 3, "stiffness": 20, "mass": 15, "fin": 15, "servo gain": 20,
             "servo torque": 20, "current": 3, "scale": 3, "friction": 0.1}  # fmt: skip
    everyday = mess.level("everyday")
    assert audit == {name: everyday[name] for name in audit}
    for name, factor in (("rough", 2), ("wrecked", 3)):
        assert mess.level(name) == {k: factor * v for k, v in everyday.items()}


def test_sides_are_the_same_at_every_size_and_differ_between_labs():
    small, large = (mess.draw(mess.times(f), [7, 1]) for f in (1.0, 2.0))
    assert large.errors.horn == pytest.approx(2 * small.errors.horn)
    assert large.wear.slack == pytest.approx(2 * small.wear.slack)
    labs = [mess.draw(mess.times(1.0), [7, i]) for i in range(40)]
    assert {np.sign(lab.errors.horn) for lab in labs} == {-1, 1}
    assert len({lab.errors.horn * lab.errors.left > 0 for lab in labs}) == 2  # independent
    assert labs[0] == mess.draw(mess.times(1.0), [7, 0])


# ---- sensors and calibration --------------------------------------------------------------------


def test_a_horn_off_its_zero_shifts_the_shaft_but_not_its_reading():
    off = world([Errors(horn=0.1)])
    off.reset()
    for _ in range(100):
        off.step(np.zeros((1, 6)))
    commanded = played(np.full(1000, 0.1), every=1000).q[0, -1]  # a good horn, and this command
    assert np.array_equal(off.simulator.qpos[0], commanded)
    assert off._encoder()[0] == pytest.approx(commanded[3] - 0.1, abs=1e-12)
    shifted = world([Errors(encoder=0.1)])
    shifted.reset()
    assert shifted._encoder()[0] == pytest.approx(0.1, abs=1e-12)
    assert shifted.simulator.qpos[0, 3] == 0


def test_frames_show_a_tag_where_it_is_glued_in_the_camera_s_own_frame():
    glued = Errors(ahead=0.02, left=-0.01, askew=0.1)
    low, high = FISH.motor.range or (0.0, 0.0)
    slow = replace(STILL, actions=Generator(low, high, offset=0.8))  # it turns little
    exact, seen = (observed(world(w, slow))[1][-1, 0, 0] for w in ((), [glued]))
    (x, y, yaw), (u, v, w) = exact[:3], seen[:3]
    cos, sin = np.cos(yaw), np.sin(yaw)
    there = [x + 0.02 * cos + 0.01 * sin, y + 0.02 * sin - 0.01 * cos]
    assert np.allclose([u, v], there, atol=1e-9) and w == pytest.approx(yaw + 0.1)
    assert np.allclose(seen[3:5], exact[3:5])  # the target's own tag is not askew
    bent = observed(world([Errors(scale=0.03, turn=0.2, lens=0.002)], slow))[1][-1, 0, 0]
    for at in (slice(0, 2), slice(3, 5)):
        place = exact[at]
        far = (1.03 + 0.002 * place @ place) * place
        turned = [[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]] @ far
        assert np.allclose(bent[at], turned, atol=1e-9)


def test_a_turned_frame_changes_nothing_that_a_policy_observes():
    """Fish and target turn together, so this nuisance alone must cost nothing."""
    first, second = (observed(world(w))[0] for w in ((), [Errors(turn=0.7)]))
    assert np.allclose(first, second, atol=1e-5)


def test_the_yaw_rate_has_the_bias_and_the_drift_that_were_set():
    settings = replace(STILL, task=replace(STILL.task, seconds=4.0))
    wrongs = (), [Errors(yaw_rate_bias=0.1)], [Errors(yaw_rate_drift=0.3)]
    seen = []
    for one in (world(wrong, settings) for wrong in wrongs):
        one.reset()
        seen.append([one.step(np.zeros((1, 6))).observation[0] for _ in range(200)])
    exact, biased, drifted = np.array(seen)
    column = np.flatnonzero(np.abs(biased[-1] - exact[-1]) > 1e-6)
    assert column.size == 1  # nothing else is touched
    scale = (biased[-1] - exact[-1])[column[0]] / 0.1
    assert np.allclose((biased - exact)[:, column[0]], 0.1 * scale, atol=1e-6)
    late = (drifted - exact)[:, column[0]] / scale
    assert late[0] == pytest.approx(0, abs=1e-3) and late[-1] == pytest.approx(0.3, abs=3e-3)


def test_a_late_camera_is_as_stale_as_it_is_late_and_bursts_hide_it_as_long():
    exact, late = (observed(world(w))[1][20:, 0, 0, 5] for w in ((), [Errors(late=0.04)]))
    assert np.mean(late - exact) == pytest.approx(0.04, abs=0.003)
    dark = observed(world([Errors(dark=0.3)]), steps=1000)[1][:, 0, 0, 5]
    assert 0.28 < dark.max() < 0.7  # some bursts follow one another
    share = np.mean(
        [errors.dark_steps(0.06, 1500, np.random.default_rng(i)).mean() for i in range(40)]
    )
    assert share == pytest.approx(0.06, abs=0.01)  # 60 ms a second


# ---- wear ---------------------------------------------------------------------------------------


def test_a_bent_tail_rests_bent_where_its_motor_lets_it():
    """With the tendons cut, the tail comes to rest at its bend, either way."""
    for bend in (0.2, -0.2):
        plant = build_plant(FISH, around=[Surroundings(held=True)], wear=[Wear(bend=bend)])
        plant.own.tendon["stiffness"][0] = plant.own.tendon["damping"][0] = 0.0
        rest = step_plant(plant, at_rest(plant), np.zeros((1, 5000)), 5000).q[0, -1, 4:]
        assert np.allclose(rest, bend / len(rest), atol=1e-3)


def test_slack_is_the_turn_of_the_shaft_that_moves_no_tail():
    """A slow shaft within its slack bends nothing; beyond, the tail follows by the rest."""
    slow = 0.5 * np.minimum(np.arange(4000) / 3000, 1.0)
    held = [Surroundings(held=True)]
    for fish in (FISH, SOFT, BOTH_WAYS):
        tight, loose = (played(slow, [Wear(slack=s)], held, fish).q[0] for s in (0.0, 0.2))
        within = (tight[:, 3] > 0.05) & (loose[:, 3] < 0.15)
        assert np.abs(loose[within, 4:].sum(axis=1)).max() < 0.02
        assert tight[-1, 4:].sum() > loose[-1, 4:].sum() + 0.05
        gear = tight[-1, 4:].sum() / tight[-1, 3]
        assert loose[-1, 4:].sum() == pytest.approx(gear * (loose[-1, 3] - 0.2), rel=0.15)


def test_a_sticking_tail_stays_bent_within_what_was_set():
    """Let go with the tendons cut: bent by less, it stays; by more, it ends within."""
    plant = build_plant(FISH, around=[Surroundings(held=True)] * 2, wear=[Wear(sticking=0.2)])
    plant.own.tendon["stiffness"][:] = plant.own.tendon["damping"][:] = 0.0
    state, links = at_rest(plant), len(plant.chain.hinges)
    state.q[:, 4:] = np.array([[0.15], [0.5]]) / links
    bent = step_plant(plant, state, np.zeros((2, 1000)), 1000).q[:, -1, 4:].sum(axis=1)
    assert 0.12 < bent[0] < 0.151 and abs(bent[1]) < 0.2  # it creeps at 2 mrad/s a hinge


def test_a_tether_pulls_with_its_force_and_drags_with_the_square_of_speed():
    """The momentum that a pull gives in its first moment, over the same push as a poke."""
    pulled = Surroundings(tether=(0.5, 0.0, 0.0))
    poked = Surroundings(pokes=((0.0, 10.0, 0.5, 0.0, 0.0),))
    first, second = (played(np.zeros(500), around=[one]).q[0] for one in (pulled, poked))
    assert np.array_equal(first, second)
    free, dragged = (
        played(np.zeros(15000), around=[Surroundings(tether=(0.5, 0.0, drag))]).v[0, -1, 0]
        for drag in (0.0, 10.0)
    )
    own = 0.5 / free**2  # N s^2/m^2, the fish's own drag
    assert dragged == pytest.approx(np.sqrt(0.5 / (own + 10.0)), rel=0.1)


def test_a_steady_current_carries_a_still_fish_along():
    lab = mess.draw({"current": 10.0}, [0, 5])
    _, around = mess.in_lab(lab, Water(), CALM[0])
    v = played(np.zeros(15000), around=[around]).v[0, -1, :2]
    assert np.hypot(*v) == pytest.approx(0.1, rel=0.1)


def test_a_fading_servo_ends_at_what_is_left_of_its_torque():
    """Against a stalled tail: the torque's limit over time."""
    plant = build_plant(FISH, around=[Surroundings(held=True)], wear=[Wear(fade=0.4, limit=0.1)])
    swum = step_plant(plant, at_rest(plant), np.full((1, 60000), 1.4), 500)
    limit = 0.1 * FISH.servos[FISH.servo].force_limit
    expected = limit * (1 - 0.4 * (1 - np.exp(-swum.time[1:] / FADING)))
    assert np.allclose(swum.torque[0, 1:], expected, rtol=1e-3)


def test_factors_reach_what_they_are_factors_of():
    own = build_plant(FISH, wear=[Wear(mass=1.2, stiffness=0.8, damping=1.5, fin=1.1, centre=0.01,
                                       gain=0.9, limit=0.7, delay=0.01, friction=0.2)])  # fmt: skip
    plain = build_plant(FISH)
    for name, field, factor in (
        ("bodies", "mass", 1.2), ("bodies", "inertia", 1.2), ("hinges", "stiffness", 0.8),
        ("hinges", "damping", 1.5), ("fins", "height", 1.1),
    ):  # fmt: skip
        values = (getattr(one.own, name)[field] for one in (own, plain))
        assert np.allclose(*(v / f for v, f in zip(values, (factor, 1.0), strict=True))), field
    assert np.all(own.own.fins["slope"] > plain.own.fins["slope"])  # a longer span lifts more
    shift = own.own.bodies["centre"][0] - plain.own.bodies["centre"][0]
    assert shift[0] == pytest.approx(0.01) and not shift[1:].any()
    for field, factor in (("kp", 0.9), ("kv", 0.9), ("force_limit", 0.7)):
        assert own.servo[field][0] == pytest.approx(factor * plain.servo[field][0])
    assert own.servo["delay"][0] - plain.servo["delay"][0] == pytest.approx(0.01)
    assert own.servo["friction"][0] - plain.servo["friction"][0] == pytest.approx(0.2)


def test_mirrored_wear_and_command_give_mirrored_motion():
    wear = Wear(bend=0.1, slack=0.05, sticking=0.05, stiffness=1.3, fade=0.2)
    command = beats(3.0, centre=0.2)
    pull = Surroundings(tether=(0.05, 0.03, 0.5))
    first = played(command, [wear], [pull])
    other = Surroundings(tether=(0.05, -0.03, 0.5))
    second = played(-command, [replace(wear, bend=-0.1)], [other])
    mirror = np.array([1.0, -1.0, *[-1.0] * (first.q.shape[2] - 2)])
    assert np.allclose(first.q, mirror * second.q, atol=1e-9)


def test_worn_fish_in_a_batch_swim_as_they_would_alone_and_so_do_parts_of_it():
    wears = [mess.draw(mess.level("rough"), [0, i]).wear for i in range(4)]
    command = np.tile(beats(), (4, 1))
    together = played(command, wears).q
    for i in (0, 3):
        assert np.array_equal(played(command[i], [wears[i]]).q[0], together[i])
    plant = build_plant(FISH, wear=wears)
    chosen = np.array([1, 2])
    some = plant.part(chosen)
    assert np.array_equal(step_plant(some, at_rest(some), command[:2], 10).q, together[chosen])


# ---- recordings ---------------------------------------------------------------------------------


def test_a_recording_in_a_messy_lab_is_off_by_what_the_lab_is_off():
    """Of a still fish: the tag where it is glued, the shaft at its horn's angle."""
    wrong = Errors(horn=0.1, encoder=0.02, ahead=0.02, left=0.01, askew=0.05, scale=0.03)
    lab = mess.Lab(errors=wrong)
    still = Recording("still", np.array([0.0, 1.0]), {"command_rad": np.array([-0.1, -0.1])})
    clean, messy = (
        next(record_fluid(FISH, 0, commands=[command], lab=own))
        for own, command in ((mess.Lab(), zero(still)), (lab, still))
    )
    assert clean.meta["source"] != messy.meta["source"]
    off = messy.columns["motor_angle_rad"] - clean.columns["motor_angle_rad"]
    assert np.allclose(off, -0.1 + 0.02, atol=0.002)  # the shaft itself is at 0 in both
    poses = [np.array([one.columns[c].mean() for c in ("x_m", "y_m", "yaw_rad")])
             for one in (clean, messy)]  # fmt: skip
    expected = errors.filmed(errors.rows([wrong]), poses[0][None])[0]
    assert np.allclose(poses[1], expected, atol=2e-3)


def test_a_late_and_hidden_camera_is_late_and_hidden_in_recordings():
    beat = Recording("beat", np.arange(0, 8, 0.02), {"command_rad": beats(8.0)[::10]})
    clean, late, dark = (
        next(record_fluid(FISH, 0, commands=[beat], lab=mess.Lab(errors=wrong)))
        for wrong in (errors.NONE, Errors(late=0.1), Errors(dark=0.3))
    )
    assert len(dark.time) < 0.9 * len(clean.time) and np.diff(dark.time).max() > 0.29
    x = [one.columns["x_m"] for one in (clean, late)]
    moved = slice(240, 400)  # steady
    speed = np.polyfit(clean.time[moved], x[0][moved], 1)[0]
    assert np.mean(x[0][moved] - x[1][moved]) == pytest.approx(0.1 * speed, rel=0.2)


def zero(command):
    return Recording(command.name, command.time, {"command_rad": 0 * command.time})


def test_record_takes_a_level_and_refuses_others(tmp_path):
    words = ("record", "check", "--fish", "pulley-fish", "--out", tmp_path / "a")
    said = complaint(*words, "--mess", "dirty")
    assert "mess 'dirty': allowed are clean, everyday, rough, wrecked, or a TOML file" in said


# ---- training -----------------------------------------------------------------------------------


def test_each_episode_of_a_training_draws_its_own_errors_alone_as_in_a_batch():
    widths = Errors(horn=0.1, left=0.02, yaw_rate_bias=0.2, late=0.02, dark=0.06)
    settings = replace(NOISY, errors=widths)
    batch = World(FISH, settings, [1, 2])
    seen, _ = observed(batch, 20)
    drawn = batch.wrong.copy()
    assert np.all(np.abs(drawn["horn"]) <= 0.1) and drawn["horn"][0] != drawn["horn"][1]
    assert np.all(drawn["late"] >= 0) and not drawn["scale"].any()
    alone, _ = observed(World(FISH, settings, [2]), 20)
    assert np.array_equal(alone[:, 0], seen[:, 1])
    batch.reset()
    assert np.all(batch.wrong["horn"] != drawn["horn"])
    batch.change(NOISY)
    batch.reset()
    assert not batch.wrong["horn"].any() and not batch.seen.late.any()


# ---- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: mess.draw({"horn": -1.0}, [0]), r"nuisance horn: -1 deg; allowed is 0 to 60 deg"),
        (lambda: mess.draw({"hom": 1.0}, [0]), r"nuisance 'hom': give horn, bend"),
        (lambda: mess.draw({"horn": float("nan")}, [0]), r"nuisance horn: nan deg; allowed"),
        (lambda: mess.level("filthy"), r"mess 'filthy': allowed are clean, everyday"),
        (lambda: build_plant(FISH, wear=[Wear(mass=0.0)]), r"wear: mass = 0; allowed is above 0"),
        (
            lambda: build_plant(FISH, wear=[Wear(slack=-0.1)]),
            r"slack = -0.1; allowed is 0 or more",
        ),
        (
            lambda: build_plant(FISH, wear=[Wear(fade=1.0)]),
            r"fade = 1; allowed is 0 to below 1",
        ),
        (
            lambda: build_plant(FISH, wear=[Wear(bend=np.inf)]),
            r"bend = inf; allowed is a finite",
        ),
        (lambda: build_plant(FISH, wear=[Wear(delay=0.3)]), r"a servo's delay of .* with its wear"),
        (lambda: build_plant(FISH, [Water()] * 3, wear=[Wear()] * 2), r"3 waters, .* wear of 2"),
        (lambda: world([Errors(late=0.2)]), r"errors: late = 0.2; allowed is 0 to 0.15"),
        (
            lambda: check_settings(FISH, replace(STILL, errors=Errors(scale=0.03))),
            r"errors: scale = 0.03; allowed is 0, because relabelled targets",
        ),
        (lambda: check_settings(FISH, replace(STILL, errors=Errors(horn=-0.1))), r"horn = -0.1"),
    ],
)
def test_what_no_lab_can_have_is_refused(make, match):
    with pytest.raises(BadInput, match=match):
        make()


def test_the_benchmark_swims_every_level_and_compares_it_with_the_clean_one(monkeypatch):
    for name, value in (("FISH", 2), ("STEPS", 3), ("REPEATS", 1)):
        monkeypatch.setattr(messy, name, value)
    found = messy.messy_bench()
    assert [row.labs for row in found] == list(mess.LEVELS)
    assert found[0].over_clean == 1.0 and all(row.per_core > 0 for row in found)
