"""The first check of a fish as rows of tables."""

import math
from typing import Any

from tailbeat.fish.buoyancy import Buoyancy
from tailbeat.fish.check import Check, Reach, Strength, Tail
from tailbeat.fish.convergence import Deviation
from tailbeat.fish.quick_swims import Quick

Rows = list[dict[str, Any]]


def check_tables(found: Check) -> dict[str, Rows]:
    """Rows by the titles of their tables."""
    return {
        "buoyancy": [_buoyancy(found.buoyancy)],
        "tail at the shaft": [] if found.tail is None else [_tail(found.tail)],
        "servo alone": [] if found.servo is None else [_strength(found.servo)],
        "servo's reach in water": [_reach(one) for one in found.reach],
        "quick swims": [_quick(one) for one in found.swims],
        "step": [_step(found.step)],
    }


def _buoyancy(found: Buoyancy) -> dict[str, Any]:
    return {
        "mass_kg": found.mass,
        "displaced_as_ellipsoids_kg": found.ellipsoids,
        "displaced_as_boxes_kg": found.boxes,
        "centre_of_mass_x_m": found.centre_of_mass,
        "centre_of_volume_x_m": found.centre_of_volume,
    }


def _tail(found: Tail) -> dict[str, Any]:
    return {
        "stiffness_n_m_rad": found.stiffness,
        "inertia_in_air_kg_m2": found.inertia_air,
        "inertia_in_water_kg_m2": found.inertia_water,
        "resonance_in_air_hz": found.resonance_air,
        "resonance_in_water_hz": found.resonance_water,
    }


def _strength(found: Strength) -> dict[str, Any]:
    return {
        "stall_torque_n_m": found.stall,
        "no_load_speed_rad_s": found.no_load,
        "static_bend_deg": math.degrees(found.bend),
    }


def _reach(one: Reach) -> dict[str, Any]:
    return {"beat_hz": one.frequency, "stroke_deg": math.degrees(one.stroke), "limit": one.limit}


def _quick(one: Quick) -> dict[str, Any]:
    return {
        "beat_hz": one.frequency,
        "speed_m_s": one.speed,
        "tip_excursion_m": one.excursion,
        "strouhal": one.strouhal,
        "reynolds": one.reynolds,
        "circle_radius_m": one.circle,
    }


def _step(found: Deviation) -> dict[str, Any]:
    return {
        "step_s": found.simulation.step,
        "integrator": found.simulation.integrator,
        "error_percent_of_the_way": 100 * found.error,
    }
