"""The virtual test bench measures the tail and not its own drive: closed form of a driven chain."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tailbeat.fish.check import tail_of
from tailbeat.fish.description import Fish
from tailbeat.fish.first_draft import described
from tailbeat.fish.linkage import moment_arms
from tailbeat.fish.proportions import Given, sketch
from tailbeat.fish.show import read_back, shaft_stiffness
from tailbeat.fish.store import load_fish, with_values
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.protocol import limits
from tailbeat.identify.tail import identify_tail
from tailbeat.pool.chain import TIE, TIE_DAMPING
from tailbeat.pool.compiled import forget_older
from tailbeat.pool.protocols import record_tail
from tailbeat.pool.recorder import CELL_COUNT, Sensors, torque_cell_for
from tailbeat.pool.water import Water

QUIET = Sensors(torque_noise=0.0, torque_count=1e-7)
NOTHING = replace(Water(), density=1e-3)  # so light that its part in the torque is below 1e-6
FISH = {
    "paper": with_values(load_fish("pulley-fish"), {"tail.friction": 0.0}),
    "small": described(sketch(Given(0.28, 0.35, 4, "xl330"))),
    "tiny": described(sketch(Given(0.15, 0.1, 2, "xl330"))),
    "large": described(sketch(Given(1.0, 12.0, 5, "xm540"))),
}


def closed_form(fish: Fish, frequency: float) -> complex:
    """Torque over angle [N m/rad] of the shaft for small strokes: hinges with K + i w C - w^2 M
    that hang on the pool's pair of tendons, and the motor's inertia."""
    dry = fish.model_copy(update={"added_inertia": 0.0})
    twin = compile_twin(dry, Options(root="fixed"))
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    arms, radius = moment_arms(twin, data)
    full = np.zeros((twin.model.nv, twin.model.nv))
    mujoco.mj_fullM(twin.model, data, full)
    omega, motor = 2 * np.pi * frequency, int(twin.model.joint("motor").dofadr[0])
    own = full[motor + 1 :, motor + 1 :]
    k = np.diag([link.stiffness for link in fish.tail.links]) * fish.tail.stiffness_scale
    hinges = (1 + 1j * omega * fish.tail.damping_time) * k - omega**2 * own
    rotor = full[motor, motor] - float(twin.model.dof_armature[motor])
    ties = 2 * (TIE + 1j * omega * TIE_DAMPING)  # in series
    yielding = (arms @ np.linalg.solve(hinges, arms) + 1 / ties) / radius**2
    return complex(1 / yielding - rotor * omega**2)


@pytest.mark.thorough
@pytest.mark.parametrize("name", FISH)
def test_the_bench_measures_the_tail_within_one_percent_up_to_the_band_s_edge(name):
    fish = FISH[name]
    sweep = next(record_tail(fish, sensors=QUIET, water=NOTHING))
    small = [c for c in identify_tail([sweep]).conditions if c.amplitude < 0.3]
    assert len({round(c.frequency, 1) for c in small}) == 4
    for condition in small:
        true = closed_form(fish, condition.frequency)
        assert condition.response.imag == pytest.approx(true.imag, rel=0.01), condition
        assert condition.response.real == pytest.approx(true.real, abs=0.01 * abs(true)), condition


def test_functions_compiled_from_another_source_are_forgotten(tmp_path):
    (tmp_path / "__pycache__").mkdir()
    source, kept = tmp_path / "a.py", tmp_path / "__pycache__" / "a.nbi"
    for text in ("one", "two"):
        source.write_text(text)
        kept.write_text("compiled")
        forget_older(tmp_path)
        assert not kept.exists()
    kept.write_text("compiled")
    forget_older(tmp_path)
    assert kept.exists()
    forget_older(Path(tmp_path / "missing"))  # nothing there: nothing to do


def test_the_bench_s_cell_and_speed_suit_the_fish():
    """The paper's fish keeps the cell and the speed with which it was identified."""
    cells = {name: _cell(fish) for name, fish in FISH.items()}
    assert cells == {"paper": 10.0, "small": 1.0, "tiny": 0.2, "large": 50.0}
    assert limits(FISH["paper"]).speed == 4.0 == limits(load_fish("pulley-fish-pool")).speed
    for name in ("small", "large"):
        servo = FISH[name].servos[FISH[name].servo]
        no_load = servo.force_limit / servo.damping
        assert 0.5 * no_load < limits(FISH[name]).speed < 0.85 * no_load


def _cell(fish: Fish) -> float:
    """Range of the cell that suits a fish [N m]."""
    suited = torque_cell_for(limits(fish).angle * shaft_stiffness(fish), Sensors())
    return round(suited.torque_count / CELL_COUNT, 6)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["small", "large"])
def test_the_numbers_of_a_tail_come_back_from_the_bench(name):
    """With the noise of the cell that suits it. Inertia with the air that it carries along; air
    damps the large tail (7 % measured)."""
    fish = FISH[name]
    sweep = next(record_tail(fish))
    count = np.diff(np.unique(sweep.columns["torque_nm"].round(9))).min()
    assert count == pytest.approx(_cell(fish) * CELL_COUNT, rel=1e-3)
    found, k = identify_tail([sweep]), read_back(fish).k_formula
    assert found.k_eff.value == pytest.approx(k, rel=0.02)
    assert found.c_eff.value == pytest.approx(k * fish.tail.damping_time, rel=0.1)
    assert found.i_eff.value == pytest.approx(inertia_in_air(fish), rel=0.06)


def inertia_in_air(fish: Fish) -> float:
    """Inertia at the shaft in air, with pulley [kg m^2]."""
    rotor = max(fish.motor.mass, 1e-6) * fish.motor.radius**2 / 2
    wet = tail_of(fish)
    return wet.inertia_air + 1.2e-3 * (wet.inertia_water - wet.inertia_air) + rotor
