"""The compiled twin equals its description, number by number, and moves as physics says."""

import mujoco
import numpy as np
import pytest

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.first_draft import described
from tailbeat.fish.linkage import moment_arms
from tailbeat.fish.proportions import Given, sketch
from tailbeat.fish.rollout import Start, replay_command, swim
from tailbeat.fish.show import read_back, shaft_stiffness, tables
from tailbeat.fish.store import load_fish, shipped, with_values
from tailbeat.fish.twin import Options, Twin, compile_twin, inertial
from tailbeat.processes import threads

REPLAYED = Options(replayed=True)


def forwarded(twin: Twin, **joints: float) -> mujoco.MjData:
    data = mujoco.MjData(twin.model)
    for name, angle in joints.items():
        data.joint(name).qpos[:] = angle
    mujoco.mj_forward(twin.model, data)
    return data


# ---- numbers ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped())
def test_masses_and_inertias_are_the_descriptions(name):
    fish = with_values(load_fish(name), {"added_inertia": 0.0})
    model = compile_twin(fish).model
    for body, stated in [
        ("head", fish.head),
        *((f"link{i}", link) for i, link in enumerate(fish.tail.links)),
    ]:
        known = inertial(stated)
        assert model.body(body).mass[0] == pytest.approx(known.mass, rel=1e-12)
        assert sorted(model.body(body).inertia) == pytest.approx(sorted(known.inertia), rel=1e-9)
    parts = [p.mass for b in (fish.head, *fish.tail.links) for p in b.parts]
    assert model.body_subtreemass[1] == pytest.approx(sum(parts) + fish.motor.mass, rel=1e-6)


def test_crank_fish_has_the_published_mass_centre_and_arms():
    """Published: 1.4807 kg, centre 117.2 mm behind the origin, arms 44.9 … -11.0, crank 33.4 mm,
    rest length 280.9 mm."""
    twin = compile_twin(with_values(load_fish("crank-fish"), {"added_inertia": 0.0}))
    data = forwarded(twin)
    assert twin.model.body_subtreemass[1] == pytest.approx(1.4807, abs=2e-4)
    assert data.subtree_com[1][0] == pytest.approx(-0.1172, abs=3e-4)
    assert data.subtree_com[1][2] == pytest.approx(0.0314, abs=3e-4)
    arms, motor = moment_arms(twin, data)
    assert 1e3 * arms == pytest.approx([44.9, 39.4, 30.0, 6.6, -11.0], abs=0.06)
    assert 1e3 * motor == pytest.approx(33.4, abs=0.06)
    assert data.ten_length == pytest.approx([0.2809, 0.2809], abs=1e-4)


def test_pulley_fish_has_the_papers_arms_and_stiffness():
    fish = load_fish("pulley-fish")
    compiled = read_back(fish)
    assert 1e3 * compiled.arms == pytest.approx([19.5, 14.5, 10.8, 7.6, 4.5], abs=1e-3)
    assert 1e3 * compiled.motor_arm == pytest.approx(17.5, rel=1e-6)
    assert compiled.k_read == pytest.approx(0.98, rel=0.01)
    assert compiled.k_read == pytest.approx(compiled.k_formula, rel=0.01)


def test_stiffness_read_at_the_shaft_follows_the_springs():
    fish = load_fish("pulley-fish")
    doubled = with_values(fish, {"tail.stiffness_scale": 2.0})
    assert shaft_stiffness(doubled) == pytest.approx(2 * shaft_stiffness(fish), rel=0.01)


def test_bent_arms_follow_from_the_guides():
    """Two guides a from the hinge at height d: length change 2 (a cos(q/2) - d sin(q/2))."""
    twin = compile_twin(load_fish("pulley-fish"))
    data = forwarded(twin, hinge0=0.4)
    arms, _ = moment_arms(twin, data)
    assert arms[0] == pytest.approx(0.0195 * np.cos(0.2) + 0.006 * np.sin(0.2), rel=1e-9)


def test_servo_is_the_descriptions_and_variants_compile():
    fish = load_fish("pulley-fish")
    for name, servo in fish.servos.items():
        model = compile_twin(fish.model_copy(update={"servo": name})).model
        assert model.actuator("servo").gainprm[0] == servo.kp
        assert -model.actuator("servo").biasprm[2] == servo.kv
        assert model.actuator("servo").forcerange[1] == servo.force_limit
        half = fish.simulation.step / 2  # see `test_the_servo_s_phase_is_exact_at_any_step`
        less = servo.armature - half * servo.damping
        assert model.joint("motor").armature[0] == pytest.approx(less)
        late = servo.delay + half if servo.delay > 0 else 0.0
        assert model.actuator_delay[0] == pytest.approx(late)


SMALL = described(sketch(Given(0.28, 0.35, 4, "xl330")))


@pytest.mark.parametrize("fish", [load_fish("pulley-fish"), SMALL], ids=["paper", "small"])
@pytest.mark.parametrize("frequency", [1.0, 4.0])
def test_the_servo_s_phase_is_exact_at_any_step(fish, frequency):
    """The motor's lag behind a held command [ms], at steps of 4 ms and of 0.25 ms. It differed by
    half a step before."""
    lag = [motor_lag(fish, frequency, step) for step in (4e-3, 2.5e-4)]
    assert lag[0] == pytest.approx(lag[1], abs=0.06)


def motor_lag(fish: Fish, frequency: float, step: float) -> float:
    """Time [ms] by which the motor lags behind a small sine, each step of it held, in air."""
    air = fish.medium.model_copy(update={"density": 1e-9, "viscosity": 0.0})
    calm = fish.simulation.model_copy(update={"step": step, "integrator": "implicitfast"})
    dry = fish.model_copy(update={"medium": air, "simulation": calm, "added_inertia": 0.0})
    twin, omega = compile_twin(dry, Options(root="fixed")), 2 * np.pi * frequency
    ends = omega * np.arange(0, 3 + step, step)
    held = 0.1 * -np.diff(np.cos(ends)) / (omega * step)
    done = swim([twin], [Start.at_rest()], [held], 1)[0]
    late = done.time > 1
    phase = omega * done.time[late]
    columns = np.column_stack([np.sin(phase), np.cos(phase), np.ones(phase.size)])
    sine, cosine, _ = np.linalg.lstsq(columns, done.qpos[late, twin.motor], rcond=None)[0]
    return float(-np.arctan2(cosine, sine) / omega * 1e3)


@pytest.mark.parametrize("name", shipped())
def test_no_body_falls_back_to_the_inertia_box_model(name):
    """Every body with mass has an ellipsoid, so it is left out of the box model."""
    model = compile_twin(load_fish(name), Options(looks=True)).model
    for body in range(1, model.nbody):
        geoms = np.flatnonzero(model.geom_bodyid == body)
        assert model.body_mass[body] < 1e-15 or (model.geom_fluid[geoms, 0] > 0).any()


@pytest.mark.parametrize("name", shipped())
def test_looks_change_no_number(name):
    fish = load_fish(name)
    plain, dressed = compile_twin(fish).model, compile_twin(fish, Options(looks=True)).model
    assert np.array_equal(plain.body_mass, dressed.body_mass)
    assert np.array_equal(plain.body_inertia, dressed.body_inertia)
    start = [Start.at_rest()]
    command = [0.3 * np.sin(np.arange(300) * 0.05)]
    a = swim([compile_twin(fish)], start, command, 10)[0]
    b = swim([compile_twin(fish, Options(looks=True))], start, command, 10)[0]
    assert np.array_equal(a.qpos, b.qpos)


def test_free_and_planar_roots_agree_on_a_level_start():
    """Symmetric above and below, the pulley fish has no cause to leave the plane."""
    fish = load_fish("pulley-fish")
    command = 0.4 * np.sin(2 * np.pi * 1.5 * np.arange(400) * fish.simulation.step)
    planar = swim([compile_twin(fish)], [Start.at_rest()], [command], 5)[0]
    free = compile_twin(fish, Options(root="free"))
    data = mujoco.MjData(free.model)
    for value in command:
        data.ctrl[0] = value
        mujoco.mj_step(free.model, data)
    assert data.qpos[:2] == pytest.approx(planar.qpos[-1, :2], abs=2e-3)
    assert abs(data.qpos[2]) < 1e-6


# ---- motion -------------------------------------------------------------------------------------


def beat(fish, frequency=1.5, amplitude=0.5, seconds=4.0, **changes):
    twin = compile_twin(with_values(fish, changes) if changes else fish)
    step = twin.model.opt.timestep
    command = amplitude * np.sin(2 * np.pi * frequency * np.arange(round(seconds / step)) * step)
    return swim([twin], [Start.at_rest()], [command], max(round(0.02 / step), 1))[0]


def test_positive_motor_angle_bends_the_tip_to_the_left():
    fish = load_fish("pulley-fish")
    twin = compile_twin(fish)
    done = swim([twin], [Start.at_rest()], [np.full(200, 0.5)], 10)[0]
    tip, head = done.markers[-1, 2], done.qpos[-1]
    left = -np.sin(head[2]) * (tip[0] - head[0]) + np.cos(head[2]) * (tip[1] - head[1])
    assert left > 0.02
    crank = compile_twin(load_fish("crank-fish"), REPLAYED)
    angle = np.linspace(0, np.pi / 2, 500)
    start = Start(np.zeros(3), np.zeros(3), 0.0, (angle[1] - angle[0]) / 0.004)
    pulled = swim([crank], [start], [replay_command(crank, angle)], 10)[0]
    assert pulled.qpos[-1, crank.motor + 1] > 0.1


def test_mirrored_command_gives_mirrored_motion():
    fish = load_fish("pulley-fish")
    right, left = beat(fish, amplitude=0.5), beat(fish, amplitude=-0.5)
    mirror = np.ones(right.qpos.shape[1])
    mirror[1:] = -1.0
    assert np.allclose(left.qpos, right.qpos * mirror, atol=1e-8)


def test_still_servo_in_still_water_stays():
    done = beat(load_fish("pulley-fish"), amplitude=0.0)
    assert np.abs(done.qpos).max() == 0.0


@pytest.mark.parametrize("name", shipped())
def test_batch_equals_single_at_any_number_of_threads(name):
    twin = compile_twin(load_fish(name))
    rng = np.random.default_rng(0)
    commands = [0.4 * np.sin(rng.uniform(4, 12) * np.arange(n) * 0.004) for n in (300, 200, 250)]
    starts = [Start.at_rest()] * 3
    together = swim([twin] * 3, starts, commands, 5, threads=2)
    for start, command, done in zip(starts, commands, together, strict=True):
        alone = swim([twin], [start], [command], 5, threads=1)[0]
        assert np.array_equal(alone.qpos, done.qpos)
        assert np.array_equal(alone.markers, done.markers)


def test_the_environment_says_how_many_threads_step_a_batch(monkeypatch):
    monkeypatch.setenv("TAILBEAT_THREADS", "1")
    assert threads() == 1
    monkeypatch.delenv("TAILBEAT_THREADS")
    assert threads() == 0
    monkeypatch.setenv("TAILBEAT_THREADS", "two")
    with pytest.raises(BadInput, match="TAILBEAT_THREADS=two: give a whole number"):
        threads()


def test_replay_follows_the_recorded_angle():
    twin = compile_twin(load_fish("pulley-fish"), REPLAYED)
    clock = np.arange(1001) * twin.model.opt.timestep
    angle = 0.5 * np.sin(2 * np.pi * 1.7 * clock) + 0.2 * np.sin(2 * np.pi * 4 * clock + 1)
    start = Start(np.zeros(3), np.zeros(3), angle[0], (angle[1] - angle[0]) / clock[1])
    done = swim([twin], [start], [replay_command(twin, angle)], 5)[0]
    assert np.abs(done.qpos[:, twin.motor] - angle[::5]).max() < 1e-4


def test_delay_is_met_between_steps():
    """A step command moves the shaft first after the delay, at 14 ms as at 14.7 ms."""
    fish = load_fish("pulley-fish")
    moved = []
    for delay in (0.014, 0.0147):
        quick = with_values(fish, {"servos.identified.delay": delay, "simulation.step": 0.0005})
        done = swim([compile_twin(quick)], [Start.at_rest()], [np.full(60, 0.2)], 1)[0]
        moved.append(done.time[np.flatnonzero(done.qpos[:, 3])[0]])
    assert 0.014 - 1e-9 < moved[0] < 0.0152
    assert 0.0147 < moved[1] < 0.0157
    assert moved[0] < moved[1]


def converged_speed(name: str, step: float) -> float:
    fish = with_values(load_fish(name), {"simulation.step": step})
    crank = fish.motor.kind == "crank"
    twin = compile_twin(fish, Options(replayed=crank))
    clock = np.arange(0, 6.0, step)
    phase = 2 * np.pi * (1.2 if crank else 1.5) * clock
    command = replay_command(twin, phase) if crank else 0.6 * np.sin(phase)
    start = Start(np.zeros(3), np.zeros(3), 0.0, 2 * np.pi * 1.2 if crank else 0.0)
    done = swim([twin], [start], [command], round(0.02 / step))[0]
    half = done.time.size // 2
    assert not done.diverged
    return float(np.linalg.norm(done.qpos[-1, :2] - done.qpos[half, :2]))


@pytest.mark.parametrize("name", shipped())
def test_steps_from_half_to_four_ms_give_the_same_swim(name):
    speeds = [converged_speed(name, step) for step in (0.0005, 0.001, 0.002, 0.004)]
    middle = np.median(speeds)
    assert np.abs(np.array(speeds) / middle - 1).max() < 0.02


# ---- added inertia ------------------------------------------------------------------------------


def mean_water_force(added: float) -> float:
    """Mean force [N] along x on the beating tail of a held crank fish in still, ideal water."""
    values = {"added_inertia": added, "added_along": 1.0, "medium.viscosity": 0.0}
    zones = {
        f"zones.{zone}.{name}": 0.0
        for zone in ("head", "tail", "fin")
        for name in ("blunt", "slender", "angular", "kutta", "magnus")
    }
    wet = compile_twin(with_values(load_fish("crank-fish"), values | zones)).model
    dry_values = values | zones | {"added_inertia": 0.0, "medium.density": 1e-12}
    dry = compile_twin(with_values(load_fish("crank-fish"), dry_values)).model
    forces = [_inverse(wet, t)[0] - _inverse(dry, t)[0] for t in np.arange(64) / 64]
    return -float(np.mean(forces))


def _inverse(model: mujoco.MjModel, share: float) -> np.ndarray:
    """Forces that keep the head still while the hinges beat at 1 Hz with a lag to the rear."""
    model.opt.timestep = 1e-9  # the inverse of an implicit step would mix damping in otherwise
    data = mujoco.MjData(model)
    lag = np.array([0.0, 0.3, 0.6, 1.0, 1.5])
    phase, swing = 2 * np.pi * share - lag, np.array([0.2, 0.2, 0.15, 0.1, 0.3])
    data.qpos[4:9] = swing * np.sin(phase)
    data.qvel[4:9] = 2 * np.pi * swing * np.cos(phase)
    data.qacc[4:9] = -((2 * np.pi) ** 2) * swing * np.sin(phase)
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse


def test_added_inertia_has_no_mean_force_and_the_engines_half_has():
    """In ideal still water a periodic motion leaves no mean force (momentum is periodic). The
    engine's velocity half alone pulls the beating tail rearwards, to negative x."""
    assert abs(mean_water_force(1.0)) < 1e-6
    assert mean_water_force(0.0) < -0.01


def test_without_added_inertia_the_crank_fish_starts_backwards():
    fish = load_fish("crank-fish")

    def way(added: float) -> float:
        twin = compile_twin(with_values(fish, {"added_inertia": added}), REPLAYED)
        angle = 2 * np.pi * np.arange(0, 8, 0.004)
        start = Start(np.zeros(3), np.zeros(3), 0.0, 2 * np.pi)
        done = swim([twin], [start], [replay_command(twin, angle)], 5)[0]
        return float(done.qpos[-1, 0])

    assert way(1.0) > 0.3
    assert way(0.0) < 0.0


@pytest.mark.thorough
def test_show_warns_of_what_a_user_should_know():
    fish = load_fish("pulley-fish")
    assert any("added inertia" in row["warning"] for row in tables(fish)["warnings"])
    wrong = with_values(fish, {"tail.k_eff": 1.1})
    assert any("compiled k_eff" in row["warning"] for row in tables(wrong)["warnings"])


def test_a_diverging_twin_says_so_and_does_not_disturb_its_neighbour(tmp_path, monkeypatch):
    """Springs this stiff do not hold at 20 ms."""
    monkeypatch.chdir(tmp_path)
    good = with_values(load_fish("crank-fish"), {"simulation.step": 0.02})
    wild = with_values(good, {"tendons.stiffness": 1e7, "tail.stiffness_scale": 1e4})
    twins = [compile_twin(fish, REPLAYED) for fish in (good, wild, good)]
    angle = np.linspace(0, 4 * np.pi, 101)
    command = replay_command(twins[0], angle)
    start = Start(np.zeros(3), np.zeros(3), 0.0, 2 * np.pi)
    done = swim(twins, [start] * 3, [command] * 3, 1)
    assert done[1].diverged and not done[1].qpos.any() and np.isfinite(done[1].markers).all()
    assert np.array_equal(done[0].qpos, done[2].qpos)
    assert list(tmp_path.iterdir()) == []  # no engine log either


def test_a_taut_tendon_is_stiffer_than_the_engine_would_make_it():
    """A hundredth of its softness is left: the tail pulls on its pulley, not on a spring."""
    fish = load_fish("pulley-fish")
    twin = compile_twin(fish)
    own = compile_twin(fish).model
    mujoco.mj_setConst(own, mujoco.MjData(own))
    assert twin.model.tendon_invweight0 == pytest.approx(0.01 * own.tendon_invweight0)
    assert (own.tendon_invweight0 > 0).all()
