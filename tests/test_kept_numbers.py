"""Where data decide nothing the user's number stays, and what diverges is never written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synthetic import record
from tailbeat.files import BadInput
from tailbeat.fish import convergence
from tailbeat.fish.description import Simulation
from tailbeat.fish.store import load_fish, with_values, write_identified
from tailbeat.identify import job, stages, step_check
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.intervals import estimates
from tailbeat.identify.search import Effort, Fit
from tailbeat.identify.space import Parameter
from tailbeat.identify.tail import identify_tail
from tailbeat.identify.tail_report import combine, toml_values
from tailbeat.recording import write_recording
from tailbeat.report import bench_figures
from test_tail import TRUTH, bench_42

FISH = load_fish("pulley-fish")


@pytest.fixture(scope="module")
def measured():
    return identify_tail(bench_42(0))


def test_an_undecided_damping_leaves_the_described_one(measured):
    """Found on a small fish: -0.0002 N m s/rad wrote 0 over 12 ms, and Euler diverged on it."""
    doubtful = replace(measured, c_eff=Estimate(-2e-4, (-9e-4, 5e-4), "N m s/rad"))
    found = combine(FISH, doubtful, None, None)
    assert found.damping_time == FISH.tail.damping_time > 0
    written = toml_values(found, ["sweep"])["tail.damping_time"]
    assert isinstance(written, dict) and written["value"] == FISH.tail.damping_time
    assert written["source"].startswith("as described") and "do not decide" in written["source"]
    written = toml_values(combine(FISH, measured, None, None), ["sweep"])["tail.damping_time"]
    assert isinstance(written, dict)
    assert written["value"] == pytest.approx(TRUTH.c_eff / TRUTH.k_eff, rel=0.05)
    assert written["source"] == "identified on sweep"


def test_an_undecided_friction_leaves_the_described_one(measured):
    rubbing = with_values(FISH, {"tail.friction": 0.02})
    doubtful = replace(measured, coulomb=Estimate(0.001, (-0.002, 0.004), "N m"))
    assert combine(rubbing, doubtful, None, None).friction == 0.02
    assert combine(rubbing, measured, None, None).friction == measured.coulomb.value


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (2.0, True), (0.5, True)])
def test_an_inertia_unlike_the_compiled_one_is_said(measured, factor, said):
    compiled = combine(FISH, measured, None, None).hinges.i_compiled
    value = factor * compiled
    inertia = Estimate(value, (0.98 * value, 1.02 * value), "kg m^2")
    warnings = combine(FISH, replace(measured, i_eff=inertia), None, None).warnings
    assert any("the tail's inertia at the shaft is" in text for text in warnings) == said


def test_a_number_at_the_end_of_its_range_is_not_decided():
    assert not Estimate(6.3, (6.1, 6.3)).decided and not Estimate(0.5, (0.5, 0.51)).decided
    assert Estimate(6.2, (6.1, 6.3)).decided
    space = (Parameter("a", "1", 0.5, 2.0, 1.0, 0.5), Parameter("b", "1", 0.5, 2.0, 1.0, 0.5))
    fit = Fit(0, np.array([9.0, 0.0]), 1.0, np.zeros(3), np.eye(3, 2), 1e-4 * np.eye(2))
    known = estimates(space, [fit])
    assert known["a"].value == 2.0 and not known["a"].decided
    assert known["b"].value == 1.0 and known["b"].decided


# ---- the step -----------------------------------------------------------------------------------


def with_step(seconds: float) -> Simulation:
    return Simulation(step=seconds, integrator="Euler")


@pytest.mark.thorough
def test_a_step_that_holds_stays_and_one_that_does_not_is_replaced():
    fish = load_fish("pulley-fish-pool")
    assert step_check.toml_values(step_check.held(fish)) == {}
    coarse = fish.model_copy(update={"simulation": with_step(0.02)})
    found = step_check.held(coarse)
    assert found.changed and found.before > convergence.ALLOWED > found.step.error
    assert "full stroke with the identified numbers" in found.warnings[0]
    fine = fish.model_copy(update={"simulation": found.step.simulation})
    assert convergence.deviation(fine).error < convergence.ALLOWED


@pytest.mark.thorough
def test_a_step_that_wrong_numbers_asked_for_does_not_stay(tmp_path: Path):
    """Found on a fish of 575 mm: with its tail identified and its servo still guessed, Euler at
    4 ms erred too much. With its own servo it holds; the implicit step that stayed costs twice."""
    fish = load_fish("pulley-fish-pool")
    described, costly = tmp_path / "described.toml", tmp_path / "costly.toml"
    text = Path(stages.fish_path("pulley-fish-pool")).read_text("utf-8")
    described.write_text(text.replace('step = "4 ms"', 'step = "1 ms"'))
    costly.write_text(text)
    made = step_check.Held(convergence.Deviation(with_step(1e-3), 0.01), True, 0.2)
    write_identified(described, costly, step_check.toml_values(made), "", overwrite=True)
    assert load_fish(costly).simulation == load_fish(described).simulation == with_step(1e-3)
    mine, ours = (step_check.is_ours(str(path)) for path in (described, costly))
    assert (mine, ours) == (False, True)
    assert not step_check.held(load_fish(described), mine).changed
    again = step_check.held(load_fish(costly), ours)
    assert again.changed and again.step.simulation == fish.simulation and not again.warnings


@pytest.mark.thorough
def test_swims_are_fitted_with_the_cheapest_step_that_repeats_them(tmp_path: Path):
    """Found on a fish of 223 mm: for full strokes at 4 Hz it needs a step that costs four times as
    much. The beats that were recorded do not. A step of the user's own stays."""
    fish, files = load_fish("pulley-fish-pool"), []
    for number, beat in enumerate((1.2, 1.6, 2.0)):
        files.append(tmp_path / f"swim-{number}.csv")
        write_recording(record(fish, files[-1].stem, beat, 0.5, seconds=3.0), files[-1])
    costly = Simulation(step=1e-3, integrator="implicit")
    text = Path(stages.fish_path("pulley-fish-pool")).read_text("utf-8")
    described, made = tmp_path / "described.toml", tmp_path / "made.toml"
    changed = text.replace('step = "4 ms"', 'step = "1 ms"').replace('"Euler"', '"implicit"')
    described.write_text(changed)
    write_identified(described, made, step_check.entries(costly), "", overwrite=True)
    for path, step in ((described, costly), (made, fish.simulation)):
        paths = stages.Paths(str(path), files, tmp_path / "out.toml")
        fitted, _ = stages.swims_of(paths, job.FluidConfig(zones=1))
        assert load_fish(path).simulation == costly and fitted.simulation == step
    few = job.FluidConfig(zones=1, seeds=1, effort=Effort(1, 4, 1), draws=2)
    stages.fluid(paths, few, lambda *_: None, lambda shown, path: None)
    assert load_fish(paths.out).simulation == fish.simulation
    assert step_check.is_ours(str(paths.out))


@pytest.mark.parametrize(
    ("euler", "implicit", "chosen"),
    [(0.5, 0.0, 0), (1.5, 0.5, 1), (np.inf, 0.5, 1), (np.inf, np.inf, None), (1.5, 1.5, None)],
)
def test_a_step_that_swims_otherwise_is_not_taken(monkeypatch, euler, implicit, chosen):
    """By how much the residuals of two cheap steps are off, in deviations."""
    own = Simulation(step=2e-3, integrator="Euler")
    off = dict(zip((*convergence.CHOICES[:2], own), (euler, implicit, 0.0), strict=True))
    monkeypatch.setattr(
        step_check, "residual_function", lambda fish, *_: lambda z: 0 * z + off[fish.simulation]
    )
    fish = load_fish("pulley-fish-pool").model_copy(update={"simulation": own})
    found = step_check.for_swims(fish, [], 1).simulation
    assert found == (own if chosen is None else convergence.CHOICES[chosen])


def test_a_fish_that_diverges_at_every_step_is_refused():
    fish = load_fish("pulley-fish-pool")
    zones = [f"zones.{zone}.kutta" for zone in fish.zones]
    wild = with_values(fish, dict.fromkeys(zones, 1e5))
    with pytest.raises(BadInput, match="diverges at every step down to"):
        step_check.held(wild)


@pytest.mark.thorough
def test_an_identified_tail_is_written_with_a_step_that_holds(tmp_path: Path):
    text = Path(stages.fish_path("pulley-fish-pool")).read_text("utf-8")
    (tmp_path / "coarse.toml").write_text(text.replace('step = "4 ms"', 'step = "20 ms"'))
    sweeps = []
    for number, sweep in enumerate(bench_42(0)):
        sweeps.append(tmp_path / f"sweep-{number}.csv")
        write_recording(sweep, sweeps[-1])
    paths = stages.Paths(str(tmp_path / "coarse.toml"), sweeps, tmp_path / "out.toml")
    stages.tail(paths, None, None, bench_figures.tail)
    written = load_fish(tmp_path / "out.toml")
    assert written.simulation.step < 0.02
    assert convergence.deviation(written).error < convergence.ALLOWED
    assert "the described step" in (tmp_path / "out.json").read_text()
    assert not list(tmp_path.glob(".*"))
