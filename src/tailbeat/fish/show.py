"""Show what a fish compiles to: numbers read back from the engine's model, and a picture."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput, refuse_existing, write_json
from tailbeat.fish import surge
from tailbeat.fish.check import check
from tailbeat.fish.check_rows import check_tables
from tailbeat.fish.description import Fish, length_of, parts_of
from tailbeat.fish.linkage import mass_matrix, moment_arms, stiffness_of
from tailbeat.fish.render import save_picture
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import Options, Twin, compile_twin

Array = NDArray[np.float64]
Tables = dict[str, list[dict[str, Any]]]  # of rows, by their titles
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
TOLERANCE = 0.01  # relative difference between stated and compiled k_eff that draws a warning


@dataclass(frozen=True, eq=False)
class Compiled:
    """Numbers read back from a compiled fish: lengths [m], masses [kg], inertia [kg m^2],
    stiffness [N m/rad].

    `mass` is the total mass in the engine, `water` the added mass in it. `k_formula` is the
    stiffness at the shaft from arms and hinges, `k_read` from pushing the compiled shaft.
    """

    mass: float
    water: float
    centre: tuple[float, ...]
    yaw_inertia: float
    length: float
    arms: Array
    motor_arm: float
    stiffness: Array
    k_formula: float
    k_read: float
    warnings: tuple[str, ...]

    @property
    def own_mass(self) -> float:
        """Mass of the fish without the added mass of the water [kg]."""
        return self.mass - self.water


def read_back(fish: Fish) -> Compiled:
    """Compile a fish and read its numbers back."""
    twin = compile_twin(fish)
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    arms, motor_arm = moment_arms(twin, data)
    stiffness = np.array([link.stiffness for link in fish.tail.links]) * fish.tail.stiffness_scale
    k_formula = stiffness_of(motor_arm, arms, stiffness)
    k_read = shaft_stiffness(fish)
    return Compiled(
        float(twin.model.body_subtreemass[1]),
        fish.added_inertia * sum(part.added_mass for part in parts_of(fish)),
        tuple(float(c) for c in data.subtree_com[1]),
        yaw_inertia(twin, data),
        length_of(fish),
        arms,
        motor_arm,
        stiffness,
        k_formula,
        k_read,
        tuple(_warnings(fish, k_read)),
    )


def yaw_inertia(twin: Twin, data: mujoco.MjData) -> float:
    """Inertia of the straight fish about the vertical axis through its centre of mass [kg m^2]."""
    full = mass_matrix(twin, data)
    if twin.options.root != "planar":
        return float("nan")
    centre = np.asarray(data.subtree_com[1])
    return float(full[2, 2] - full[0, 0] * (centre[0] ** 2 + centre[1] ** 2))


def shaft_stiffness(fish: Fish, angle: float = 0.02) -> float:
    """Stiffness at the shaft k_eff [N m/rad]: turn the shaft by `angle` [rad] and read the torque.

    The head is fixed, in a vacuum. The slack of the tendons is set to 0. For a crank this is the
    stiffness at its arm at the neutral angle.
    """
    taut = fish.tendons.model_copy(update={"slack": 0.0})
    dry = fish.medium.model_copy(update={"density": 1e-9, "viscosity": 0.0})
    held = fish.model_copy(update={"tendons": taut, "medium": dry, "added_inertia": 0.0})
    model = compile_twin(held, Options(root="fixed")).model
    return _settle(model, angle)


def stiffening(fish: Fish, angle: float = 0.6) -> float:
    """By which share the tail of a pulley is stiffer at 1 rad of its shaft [1/rad^2]: the tendon's
    arms shorten as the hinges bend, with the square of the angle. 0 for a crank."""
    if fish.motor.kind != "pulley":
        return 0.0
    return (shaft_stiffness(fish, angle) / shaft_stiffness(fish) - 1) / angle**2


def _settle(model: mujoco.MjModel, angle: float) -> float:
    """Torque over angle [N m/rad] when the tail has come to rest on a stiff, undelayed servo."""
    soft = float(model.jnt_stiffness[1:].min())  # a servo that is stiff for this tail
    model.opt.timestep = 5e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # for the servo's own damping
    model.dof_damping[1:] += 0.02 * model.jnt_stiffness[1:]
    model.dof_armature[0] = max(model.dof_armature[0], 1e-3 * soft)
    model.dof_frictionloss[:] = 0.0
    model.actuator_gainprm[0, 0] = 400 * soft
    model.actuator_biasprm[0, 1:3] = -400 * soft, -16 * soft
    model.actuator_forcerange[0] = (-1e6, 1e6)
    model.actuator_delay[0] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[0] = angle
    for _ in range(10_000):
        mujoco.mj_step(model, data)
    return float(data.actuator_force[0] / data.qpos[0])


def _warnings(fish: Fish, k_read: float) -> list[str]:
    found = []
    stated = fish.tail.k_eff
    if stated is not None and abs(k_read / stated - 1) > TOLERANCE:
        found.append(
            f"the compiled k_eff is {k_read:.4g} N m/rad, the description states {stated:.4g}"
        )
    if fish.added_inertia == 0:
        found.append(
            "added inertia is off: the engine applies only the velocity half of added mass, which"
            " pulls a beating fin rearwards (docs/explain/twin.md)"
        )
    if fish.trailing_edge is None:
        found.append(
            "lift has no trailing edge: a twin that is launched backward may keep swimming backward"
            " (docs/explain/fluid-law.md)"
        )
    for name, zone in fish.zones.items():
        if zone.kutta > 6.3:
            found.append(
                f"zone {name}: Kutta {zone.kutta:g} is more lift than any ellipsoid has (6.3)"
            )
    return found


def tables(fish: Fish) -> Tables:
    """Everything `tailbeat show` prints, as rows: whole fish, first check, bodies, hinges, zones,
    servo, warnings."""
    compiled = read_back(fish)
    checked = check(fish, compiled.length)
    return {
        "fish": [_whole(fish, compiled)],
        **check_tables(checked),
        "bodies": _bodies(fish),
        "hinges": _hinges(fish, compiled),
        "zones": [{"zone": name, **zone.model_dump()} for name, zone in fish.zones.items()],
        "fluid law": [_law(fish)],
        "servo": [{"servo": fish.servo, **fish.servos[fish.servo].model_dump()}],
        "warnings": [{"warning": text} for text in (*compiled.warnings, *checked.warnings)],
    }


def _whole(fish: Fish, compiled: Compiled) -> dict[str, Any]:
    return {
        "name": fish.name,
        "length_m": compiled.length,
        "mass_kg": compiled.own_mass,
        "water_carried_kg": compiled.water,
        "centre_x_m": compiled.centre[0],
        "yaw_inertia_kg_m2": compiled.yaw_inertia,
        "k_eff_formula": compiled.k_formula,
        "k_eff_read": compiled.k_read,
        "k_eff_stated": fish.tail.k_eff,
        "step_s": fish.simulation.step,
        "integrator": fish.simulation.integrator,
    }


def _law(fish: Fish) -> dict[str, Any]:
    blend = fish.trailing_edge
    return {
        "added_inertia": fish.added_inertia,
        "added_along": fish.added_along,
        "relieved_along_kg": surge.excess(fish),
        "trailing_edge_m_s": blend and blend.speed,
        "reverse_lift": blend and blend.reverse,
    }


def _bodies(fish: Fish) -> list[dict[str, Any]]:
    model = compile_twin(fish).model
    names = ["head", "motor", *(f"link{i}" for i in range(len(fish.tail.links)))]
    return [
        {
            "body": name,
            "mass_kg": float(model.body(name).mass[0]),
            "inertia_x": float(model.body(name).inertia[0]),
            "inertia_y": float(model.body(name).inertia[1]),
            "inertia_z": float(model.body(name).inertia[2]),
        }
        for name in names
    ]


def _hinges(fish: Fish, compiled: Compiled) -> list[dict[str, Any]]:
    return [
        {
            "hinge": i,
            "x_m": link.hinge,
            "arm_m": float(compiled.arms[i]),
            "stiffness": float(compiled.stiffness[i]),
            "damping": float(compiled.stiffness[i] * fish.tail.damping_time),
        }
        for i, link in enumerate(fish.tail.links)
    ]


@dataclass(frozen=True)
class Shown:
    """The result of `show`: tables of rows, the picture, and how it was made."""

    tables: Tables
    picture: Path
    how: str


def show(
    fish: str,
    picture: Path | None,
    viewer: bool,
    json: Path | None,
    more: Callable[[Fish], Tables] = lambda fish: {},
) -> Shown:
    """Compile a fish, read its numbers back, and write a picture (default: runs/NAME.png, which is
    overwritten). `json` takes the tables, and what `more` makes of the fish. Raises BadInput if
    `picture` or `json` exists."""
    described = load_fish(fish)
    target = picture or Path("runs") / f"{described.name}.png"
    if target.suffix.lower() not in PICTURES:
        raise BadInput(f"--picture {target}: allowed are {', '.join(PICTURES)}.")
    for path in filter(None, (picture, json)):
        refuse_existing(path)
    found = tables(described) | more(described)
    twin = compile_twin(described, Options(looks=True))
    how = save_picture(twin, np.zeros(twin.model.nq), target, overwrite=picture is None)
    if json is not None:
        write_json(json, found)
    if viewer:
        from mujoco import viewer as mujoco_viewer  # needs a screen, so only when asked for

        mujoco_viewer.launch(twin.model)
    return Shown(found, target, how)
