"""A fish from a few numbers: the pulley fish's come back, and every size floats and swims."""

import json
import math
import os
import pty
import subprocess
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from support import command, tailbeat, tailbeat_process
from support import complaint as refusal
from tailbeat.cli import describe
from tailbeat.files import BadInput
from tailbeat.fish import check, convergence, first_draft, render
from tailbeat.fish.buoyancy import buoyancy
from tailbeat.fish.catalogue import profile, profiles
from tailbeat.fish.description import Fish, Simulation, length_of
from tailbeat.fish.proportions import Given, sketch
from tailbeat.fish.show import read_back
from tailbeat.fish.store import digest, load_fish, with_values
from tailbeat.fish.twin import Options, compile_twin

PULLEY = load_fish("pulley-fish")
SIZES = {
    "paper": Given(0.54, 1.218, k_eff=0.98),
    "small": Given(0.28, 0.35, 4, "xl330"),
    "tiny": Given(0.15, 0.1, 2, "xl330"),
    "large": Given(1.0, 12.0, 5, "xm540"),
    "long": Given(1.2, 20.0, 8, "xw540", fin=(0.15, 0.3)),
}


QUICK = ("small", "large")
THOROUGH = [pytest.param(one, marks=pytest.mark.thorough) for one in SIZES if one not in QUICK]


@pytest.fixture(scope="module", params=[*QUICK, *THOROUGH])
def written(request, tmp_path_factory):
    given = SIZES[request.param]
    path = tmp_path_factory.mktemp("sketch") / "mine.toml"
    return given, first_draft.new_fish(path, given), load_fish(path)


def test_the_paper_s_numbers_give_the_paper_s_fish():
    fish = first_draft.described(sketch(SIZES["paper"]))
    assert length_of(fish) == pytest.approx(length_of(PULLEY), abs=1e-4)
    for mine, theirs in zip(fish.tail.links, PULLEY.tail.links, strict=True):
        assert mine.hinge == pytest.approx(theirs.hinge, abs=1e-4)
        assert mine.stiffness == pytest.approx(theirs.stiffness, rel=0.02)
        for part, other in zip(mine.parts, theirs.parts, strict=True):
            assert part.added_mass == pytest.approx(other.added_mass, rel=0.06), part.name
    for box, other in zip(fish.head.parts, PULLEY.head.parts, strict=True):
        assert box.size == pytest.approx(other.size, rel=0.02)
        assert box.mass == pytest.approx(other.mass, rel=1e-3)
    assert read_back(fish).arms == pytest.approx(read_back(PULLEY).arms, rel=0.02)
    assert fish.band == PULLEY.band
    assert sketch(SIZES["paper"]).tag == 0.08


def test_a_tag_fits_on_the_hull_of_a_slender_fish():
    assert sketch(replace(SIZES["paper"], mass=0.31)).tag == pytest.approx(0.04)


def test_what_was_given_is_in_the_compiled_fish(written):
    given, _, fish = written
    found = read_back(fish)
    assert found.length == pytest.approx(given.length, rel=1e-3)
    assert found.mass - found.water == pytest.approx(given.mass, rel=1e-3)
    assert len(fish.tail.links) == given.hinges
    assert found.k_read == pytest.approx(fish.tail.k_eff, rel=2e-3)
    assert found.k_read == pytest.approx(given.k_eff or found.k_read, rel=2e-3)
    fin = fish.tail.links[-1].parts[-1]
    assert given.fin is None or fin.size[::2] == pytest.approx(given.fin, rel=1e-3)
    assert fish.servos[fish.servo].force_limit == profile(given.servo).stall_nm


@pytest.mark.thorough
def test_every_size_floats_swims_and_holds_its_step(written):
    _, chosen, fish = written
    found = check.check(fish, length_of(fish))
    assert found.buoyancy.ellipsoids == pytest.approx(found.buoyancy.mass, rel=0.01)
    assert max(one.speed for one in found.swims) > 0.05 * length_of(fish)
    assert found.reach[-1].stroke == pytest.approx(first_draft.LEAST_STROKE, rel=0.1) or (
        found.reach[-1].stroke > first_draft.LEAST_STROKE
    )
    assert chosen.error < convergence.ALLOWED
    assert convergence.deviation(fish).error == pytest.approx(chosen.error, abs=0.01)
    assert found.warnings == ()


def test_without_gl_the_view_grows_with_the_fish(monkeypatch):
    monkeypatch.setattr(render, "_needs_missing_screen", lambda: True)
    wide = []
    for name in ("paper", "large"):
        twin = compile_twin(first_draft.described(sketch(SIZES[name])))
        images, how = render.frames(twin, np.zeros((1, twin.model.nq)))
        image = next(images).astype(int)
        columns = np.flatnonzero((image[..., 2] - image[..., 0] > 80).any(axis=0))  # blue
        wide.append((columns[0], columns[-1]))
        assert how == "drawn"
    assert wide[0] == pytest.approx(wide[1], abs=3)


def test_every_number_that_nobody_measured_says_so(tmp_path):
    path = tmp_path / "mine.toml"
    first_draft.new_fish(path, SIZES["small"])
    lines = path.read_text().splitlines()
    lengths = [line for line in lines if ' mm"' in line or ' g"' in line]
    silent = [line for line in lengths if "#" not in line and not line.startswith(("  {", "summ"))]
    assert silent == []
    assert "# from the maker's numbers: XL330-M288-T" in path.read_text()


# ---- the catalogue ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", profiles())
def test_a_servo_has_its_maker_s_stall_torque_and_no_load_speed(name):
    one, servo = profile(name), profile(name).servo()
    assert servo.force_limit == one.stall_nm
    assert servo.force_limit / servo.damping == pytest.approx(one.no_load_rpm / 60 * 2 * math.pi)


def test_a_real_servo_s_fitted_numbers_are_within_a_half_of_the_catalogue_s():
    """XL330 logs of another lab, identified: docs/results/data/xl330.json."""
    file = Path(__file__).parents[1] / "docs/results/data/xl330.json"
    fitted = json.loads(file.read_text())["servo"]["parameters"]
    servo, gain = profile("xl330").servo(), profile("xl330").gain
    assert servo.kp == pytest.approx(gain * fitted["gain_scale"]["value"], rel=0.5)
    assert servo.armature == pytest.approx(fitted["armature"]["value"], rel=0.5)
    drag = fitted["damping"]["value"] + fitted["kv"]["value"]
    assert servo.damping == pytest.approx(drag, rel=0.5)


# ---- the check ----------------------------------------------------------------------------------


def test_the_servo_s_reach_is_what_the_compiled_twin_does():
    """The head held, no water but its added mass: what the linear model speaks of."""
    tail = check.tail_of(PULLEY)
    for one in check.reaches(PULLEY, tail)[1:]:
        assert one.stroke == pytest.approx(_stroke(one.frequency), rel=0.15), one


def test_the_servo_alone_is_the_maker_s_and_holds_what_the_compiled_twin_holds():
    """Speed without load and torque at standstill of the catalogue; a slow command bends the tail
    as far as the torque does, in the engine."""
    bought = profiles()["xl430"]
    fish = first_draft.described(sketch(Given(0.408, 0.784, 3, "xl430")))
    found = check.strength(fish, check.tail_of(fish))
    assert found.no_load == pytest.approx(bought.no_load, rel=0.01)
    assert found.stall == pytest.approx(bought.stall_nm, rel=0.01)
    weak = with_values(PULLEY, {f"servos.{PULLEY.servo}.force_limit": 0.6})
    bend = check.strength(weak, check.tail_of(weak)).bend
    assert bend == pytest.approx(_held(weak), rel=0.03) and 0.3 < bend < 0.7


def _held(fish: Fish) -> float:
    """The shaft's angle in the engine under the whole torque, at rest [rad]."""
    model = compile_twin(fish, Options(root="fixed")).model
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.3
    for _ in range(round(20 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return float(data.joint("motor").qpos[0])


def _stroke(frequency: float) -> float:
    """Stroke of the compiled twin at full command [rad]."""
    dry = PULLEY.medium.model_copy(update={"density": 1e-9, "viscosity": 0.0})
    fish = PULLEY.model_copy(update={"medium": dry, "added_inertia": 1.0})
    model = compile_twin(fish, Options(root="fixed")).model
    data, angles = mujoco.MjData(model), []
    for k in range(round(6 / model.opt.timestep)):
        angle = math.radians(80) * math.sin(2 * math.pi * frequency * k * model.opt.timestep)
        data.ctrl[0] = angle
        mujoco.mj_step(model, data)
        angles.append(float(data.joint("motor").qpos[0]))
    late = np.array(angles[len(angles) // 2 :])
    return float(np.ptp(late) / 2)


def test_flooded_parts_are_no_matter_to_the_twin():
    values = {"head.parts.1.flooded": 1.0}
    wet = with_values(PULLEY, values)
    assert digest(wet) == digest(PULLEY)
    lighter = buoyancy(wet).ellipsoids - buoyancy(PULLEY).ellipsoids
    part = PULLEY.head.parts[1]
    assert lighter == pytest.approx(part.mass - 1000 * math.pi / 6 * math.prod(part.size), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"head.parts.0.mass": 4.0}, "it sinks: 4.32 kg in a hull that displaces 2.62 kg"),
        ({"head.parts.0.mass": 0.1}, "it floats up: 0.418 kg"),
        ({"servos.identified.force_limit": 0.02}, "servo identified bends the tail by"),
        ({"tail.links.4.parts.1.added_mass": 0.0}, "no added mass on fin"),
        ({"simulation.step": 0.02}, "the step of 20 ms"),
        ({"head.parts.0.position.0": 0.2}, "it hangs"),
    ],
)
def test_what_is_wrong_is_said(changes, complaint):
    whole = {"added_inertia": 1.0, **changes}
    position = whole.pop("head.parts.0.position.0", None)
    fish = with_values(load_fish("pulley-fish-pool"), {**whole})
    if position is not None:
        fish = _nose_heavy(fish)
    said = check.check(fish, length_of(fish)).warnings
    assert any(complaint in text for text in said), said


def _nose_heavy(fish):
    shell = fish.head.parts[0]
    lead = shell.model_copy(
        update={"name": "lead", "zone": None, "mass": 0.4, "position": (0.11, 0, 0),
                "size": (0.02, 0.02, 0.02), "added_mass": 0.0}
    )  # fmt: skip
    head = fish.head.model_copy(update={"parts": (*fish.head.parts, lead)})
    return fish.model_copy(update={"head": head})


@pytest.mark.thorough
def test_the_shipped_fish_needs_no_warning_of_the_check():
    fish = load_fish("pulley-fish-pool")
    assert check.check(fish, length_of(fish)).warnings == ()


# ---- the verbs ----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_verb_writes_a_fish_that_show_accepts_strictly(tmp_path):
    path = tmp_path / "mine.toml"
    done = tailbeat_process(
        "new-fish", path, "--length", "280mm", "--mass", "350g", "--hinges", 4,
        "--servo", "xl330", "--fin", "30x70mm",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    shown = tailbeat("show", path, "--strict", "--picture", tmp_path / "p.png")
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert "speed [m/s]" in shown.stdout and "stiffness [N m/rad]" in shown.stdout
    sunk = path.read_text().replace('mass = "258.6 g"', 'mass = "900 g"')
    path.write_text(sunk)
    heavy = tailbeat("show", path, "--strict", "--picture", tmp_path / "q.png")
    assert heavy.returncode == 1 and "it sinks" in heavy.stdout


@pytest.mark.thorough
def test_on_a_terminal_five_questions_are_asked(tmp_path):
    master, slave = pty.openpty()
    words = command("new-fish", tmp_path / "mine.toml")
    with subprocess.Popen(words, stdin=slave, stdout=slave, stderr=slave) as process:
        os.close(slave)
        os.write(master, b"28cm\n0.35\n3\nxl330\n\n")
        assert process.wait(60) == 0
    os.close(master)
    fish = load_fish(tmp_path / "mine.toml")
    assert len(fish.tail.links) == 3 and fish.servo == "xl330"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"length": 5.0}, r"--length 5 m: allowed is 0.1 to 3 m"),
        ({"mass": 0.0}, r"--mass 0 kg"),
        ({"mass": 12.0}, r"--mass 12 kg: a fish of 0.28 m that floats would be 307 mm wide"),
        ({"hinges": 1}, r"--hinges 1: allowed is 2 to 12\."),
        ({"servo": "abc"}, r"--servo 'abc': not in the catalogue \(xl330"),
        ({"servo": "xm540"}, r"--servo xm540: it weighs 165 g"),
        ({"fin": (0.2, 0.07)}, r"--fin: chord 200 mm; a fish of 280 mm may have 6 to 70 mm"),
        ({"fin": (0.03, 0.7)}, r"--fin: span 700 mm"),
        ({"k_eff": 20.0}, r"--servo xl330: its stall torque of 0.52 N m bends a tail"),
        ({"k_eff": -1.0}, r"--k-eff -1 N m/rad"),
        ({"k_eff": 1e-9}, r"usually has 0.14; allowed is 0.0014 or more, so check the unit"),
    ],
)
def test_an_impossible_fish_is_refused_before_anything_is_written(tmp_path, change, complaint):
    with pytest.raises(BadInput, match=complaint):
        first_draft.new_fish(tmp_path / "a.toml", replace(SIZES["small"], **change))
    assert not list(tmp_path.iterdir())


FINS = ("60x70mm", "60mmx70mm", "60X70mm", "60×70mm", "6cm x 70 mm", "60mmx70", "6e-2x7e-2")


@pytest.mark.parametrize("text", FINS)
def test_a_fin_is_given_with_one_unit_or_two(text):
    given = describe._measured(describe.Typed("28cm", "350g", fin=text))
    assert given.fin == pytest.approx((0.06, 0.07))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--length", "280mm"), "--mass: missing"),
        (("--length", "28x", "--mass", "1kg"), "--length: unit 'x' is not one of m, cm, mm"),
        (("--length", "mm", "--mass", "1kg"), "--length: 'mm' is not a number"),
        (("--length", "28cm", "--mass", "350g", "--fin", "60"), "--fin '60': give chord x span"),
    ],
)
def test_a_quantity_that_is_none_is_one_sentence(tmp_path, words, complaint):
    assert complaint in refusal("new-fish", tmp_path / "a.toml", *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.thorough
def test_the_step_that_diverges_is_never_chosen():
    fish = first_draft.described(sketch(SIZES["tiny"]))
    coarse, fine = (Simulation(step=step, integrator="Euler") for step in (0.02, 0.001))
    assert convergence.deviation(fish, coarse).error > convergence.ALLOWED
    assert convergence.choose(fish, (coarse, fine)).simulation == fine
