"""Compile a description for the engine: Fish -> MjSpec -> MjModel.

Joints, in order: root x, y, yaw (planar; or a free joint), motor, one hinge per tail link. A
positive motor angle bends the tail tip to the left. Fluid forces act only on massless ellipsoids;
masses and inertias are explicit.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish import edge, surge
from tailbeat.fish.bodies import Body, Inertial
from tailbeat.fish.description import Fish, Servo
from tailbeat.fish.looks import add_looks
from tailbeat.fish.units import Triple

Array = NDArray[np.float64]
Root = Literal["planar", "free", "fixed"]

# Rotor inertia that makes the motor follow a replayed angle whatever the tail does [kg m^2].
HEAVY_ROTOR = 100.0
HEAVY_LOOP = 60.0  # natural frequency of its critically damped position loop [rad/s]
HEAVY = Servo(  # undelayed, unlimited, without friction
    kp=HEAVY_ROTOR * HEAVY_LOOP**2,
    kv=2 * HEAVY_ROTOR * HEAVY_LOOP,
    armature=HEAVY_ROTOR,
    damping=0.0,
    friction=0.0,
    force_limit=1e9,
    delay=0.0,
)
# Size of a massless ellipsoid; with it the engine's inertia-box drag does not act on a dry body.
SPECK = 1e-6
# Constraint that stands for inextensible tendons: time constant [s] and damping ratio, impedance.
# The engine softens a constraint by the inertia at it. A replayed twin's tail would be half a
# percent stiffer than the same tail on its servo; so only `TAUT_SHARE` of that softness is kept.
TAUT_SOLREF = [0.008, 1.0]
TAUT_SOLIMP = [0.9999, 0.9999, 0.001]
TAUT_SHARE = 0.01


@dataclass(frozen=True)
class Options:
    """How to compile: the joint of the `root`, whether the motor is `replayed`
    (`rollout.replay_command`), and whether to add `looks` for pictures."""

    root: Root = "planar"
    replayed: bool = False
    looks: bool = False


@dataclass(frozen=True, eq=False)
class Twin:
    """A compiled fish."""

    fish: Fish
    options: Options
    model: mujoco.MjModel

    @cached_property
    def motor(self) -> int:
        """Index of the motor angle in qpos; the hinges follow it."""
        return int(self.model.joint("motor").qposadr[0])

    @property
    def taut_share(self) -> float:
        """Factor on the engine's softness of the tendons' constraint."""
        return TAUT_SHARE if self.fish.tendons.stiffness is None else 1.0

    @cached_property
    def zones(self) -> NDArray[np.int64]:
        """Zone of each geom (ngeom,) as an index into the description's zones, -1 for none."""
        found, names = np.full(self.model.ngeom, -1), list(self.fish.zones)
        for part in (p for body in (self.fish.head, *self.fish.tail.links) for p in body.parts):
            if part.zone is not None:
                found[self.model.geom(part.name).id] = names.index(part.zone)
        return found

    @cached_property
    def marker_sites(self) -> Array:
        """Site indices (m,) of the description's markers, in its order."""
        names = [marker.name for marker in self.fish.markers]
        return np.array([self.model.site(f"marker-{name}").id for name in names], dtype=int)


def compile_twin(fish: Fish, options: Options = Options()) -> Twin:
    """Compile a description. With `replayed`, the motor is a heavy rotor that follows any angle.

    Some derived fields are changed after the engine's compilation. `mj_setConst` overwrites them;
    after a call of it they must be restored (`randomize.refresh`). Raises BadInput for a fish that
    the engine refuses, such as one with a mesh that is not there.
    """
    try:
        model = build_spec(fish, options).compile()
    except ValueError as error:
        said = " ".join(str(error).split())
        raise BadInput(f"{fish.name}: the engine refuses it: {said}; correct the fish.") from None
    _set_slack(fish, model)
    twin = Twin(fish, options, model)
    model.tendon_invweight0 *= twin.taut_share
    if fish.added_inertia > 0:
        _drop_velocity_half(fish, model)
    return twin


def build_spec(fish: Fish, options: Options = Options()) -> mujoco.MjSpec:
    """The editable engine model of a fish."""
    spec = mujoco.MjSpec()
    spec.modelname = fish.name
    _set_medium(spec, fish)
    head = spec.worldbody.add_body(name="head")
    _add_root(head, options.root)
    _fill_body(head, fish, fish.head, x0=0.0)
    _add_motor(spec, head, fish, options.replayed)
    _add_links(head, fish)
    _add_markers(spec, fish)
    _add_tendons(spec, fish)
    if fish.trailing_edge is not None:
        blend = fish.trailing_edge
        spec.add_numeric(name=edge.NAME, data=[blend.speed, blend.reverse])
    if surge.excess(fish) > 0:
        spec.add_numeric(name=surge.NAME, data=[surge.excess(fish)])
    if options.looks:
        add_looks(spec, fish)
    return spec


def _set_medium(spec: mujoco.MjSpec, fish: Fish) -> None:
    option = spec.option
    option.timestep = fish.simulation.step
    option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{fish.simulation.integrator.upper()}")
    option.density, option.viscosity = fish.medium.density, fish.medium.viscosity
    option.gravity = [0, 0, 0]  # neutrally buoyant or floating; depth is not simulated
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


def _add_root(head: mujoco.MjsBody, root: Root) -> None:
    if root == "free":
        head.add_freejoint(name="root")
    if root == "planar":
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        head.add_joint(name="x", type=slide, axis=[1, 0, 0])
        head.add_joint(name="y", type=slide, axis=[0, 1, 0])
        head.add_joint(name="yaw", type=hinge, axis=[0, 0, 1])


# ---- bodies -------------------------------------------------------------------------------------


def inertial(body: Body, added: float = 0.0) -> Inertial:
    """Mass [kg], centre [m] and inertia about it [kg m^2]; x, y, z are taken as principal axes.

    From `body.inertial` if given, else from its parts as uniform boxes (parallel axes). `added`
    times each part's added mass is distributed over the part's box and included.
    """
    pieces = [_box(part.mass, part.position, part.size) for part in body.parts if part.mass]
    if body.inertial is not None:
        given = body.inertial
        pieces = [(given.mass, np.array(given.centre), np.array(given.inertia))]
    pieces += [
        _box(added * part.added_mass, part.position, part.size)
        for part in body.parts
        if added * part.added_mass > 0
    ]
    return _sum(pieces)


def _box(mass: float, position: Triple, size: Triple) -> tuple[float, Array, Array]:
    square = np.square(size)
    return mass, np.array(position), mass / 12 * (square.sum() - square)


def _sum(pieces: list[tuple[float, Array, Array]]) -> Inertial:
    masses = np.array([m for m, _, _ in pieces])
    centres = np.array([c for _, c, _ in pieces])
    mass, centre = float(masses.sum()), masses @ centres / masses.sum()
    inertia = np.zeros(3)
    for m, c, own in pieces:
        square = np.square(c - centre)
        inertia += own + m * (square.sum() - square)  # parallel axes
    return Inertial(mass=mass, centre=tuple(centre), inertia=tuple(inertia))


def _fill_body(body: mujoco.MjsBody, fish: Fish, described: Body, x0: float) -> None:
    """Give a body its inertia and its wetted ellipsoids; `x0` is the x of its frame."""
    known = inertial(described, fish.added_inertia)
    body.explicitinertial = True
    body.mass, body.inertia = known.mass, list(known.inertia)
    body.ipos = [known.centre[0] - x0, *known.centre[1:]]
    wet = [part for part in described.parts if part.zone is not None]
    for part in wet:
        body.add_geom(
            name=part.name,
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[length / 2 for length in part.size],
            pos=[part.position[0] - x0, *part.position[1:]],
            mass=0,
            fluid_ellipsoid=1,
            fluid_coefs=list(fish.zones[part.zone or ""].row()),
            group=3,  # hidden by default: the meshes of `looks` are shown instead
            rgba=[0.3, 0.6, 0.8, 0.4],
        )
    if not wet:
        _add_speck(body)


def _add_speck(body: mujoco.MjsBody) -> None:
    """A point-like ellipsoid without coefficients: turns off inertia-box drag for a body."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        size=[SPECK] * 3,
        mass=0,
        fluid_ellipsoid=1,
        fluid_coefs=[0.0] * 5,
        group=4,
    )


def _drop_velocity_half(fish: Fish, model: mujoco.MjModel) -> None:
    """Replace the virtual mass in the fluid law on every body that carries added inertia.

    The engine applies only the velocity half of added mass. With an added mass in the inertia it
    would count twice, and the mean force on an oscillating plate would not vanish. The virtual
    mass that remains cancels the inertia along the chord (`surge.py`) if `added_along` is below 1.
    """
    for body in (fish.head, *fish.tail.links):
        if any(part.added_mass > 0 for part in body.parts):
            for part in body.parts:
                if part.zone is not None:
                    row = model.geom_fluid[model.geom(part.name).id]
                    row[6:12] = 0.0
                    row[6] = surge.virtual_mass(fish, part.added_mass)


def _add_links(head: mujoco.MjsBody, fish: Fish) -> None:
    parent, x0 = head, 0.0
    for index, link in enumerate(fish.tail.links):
        parent = parent.add_body(name=f"link{index}", pos=[link.hinge - x0, 0, 0])
        x0 = link.hinge
        stiffness = link.stiffness * fish.tail.stiffness_scale
        joint = parent.add_joint(
            name=f"hinge{index}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, -1]
        )
        joint.stiffness[0], joint.damping[0] = stiffness, stiffness * fish.tail.damping_time
        _fill_body(parent, fish, link, x0)


def _add_markers(spec: mujoco.MjSpec, fish: Fish) -> None:
    for marker in fish.markers:
        name = "head" if marker.body == "head" else f"link{marker.body}"
        x0 = 0.0 if marker.body == "head" else fish.tail.links[marker.body].hinge
        x, y, z = marker.position
        spec.body(name).add_site(name=f"marker-{marker.name}", pos=[x - x0, y, z], size=[0.004] * 3)


# ---- motor and tendons --------------------------------------------------------------------------


def _add_motor(spec: mujoco.MjSpec, head: mujoco.MjsBody, fish: Fish, replayed: bool) -> None:
    motor = fish.motor
    servo = HEAVY if replayed else fish.servos[fish.servo]
    rotor = head.add_body(name="motor", pos=list(motor.position))
    rotor.explicitinertial = True
    mass = max(motor.mass, 1e-6)
    rotor.ipos = [0, 0, 0]
    rotor.mass, rotor.inertia = mass, [mass * motor.radius**2 / 2] * 3
    _add_speck(rotor)
    axis = [0, 0, -1] if motor.kind == "pulley" else [0, -1, 0]
    joint = rotor.add_joint(name="motor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    joint.armature, joint.damping[0] = _armature(spec, servo), servo.damping
    joint.frictionloss = servo.friction + (0.0 if replayed else fish.tail.friction)
    _add_anchors(rotor, fish)
    _add_servo(spec, fish, servo, replayed)


def _add_anchors(rotor: mujoco.MjsBody, fish: Fish) -> None:
    """Add the tendons' ends on the motor: the pulley's front, or the two arms of the crank."""
    motor = fish.motor
    if motor.kind == "pulley":
        rotor.add_geom(
            name="pulley",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[motor.radius, 0.005, 0],
            mass=0,
            group=2,
            rgba=[0.5, 0.5, 0.5, 1],
        )
    for side, sign in (("left", 1), ("right", -1)):
        front = [1.001 * motor.radius, 0, 0]  # a wrap must start outside its cylinder
        arm = [0, sign * motor.half_width, -sign * motor.radius]
        rotor.add_site(name=f"anchor-{side}", pos=front if motor.kind == "pulley" else arm)


def _armature(spec: mujoco.MjSpec, servo: Servo) -> float:
    """Armature [kg m^2] less what implicit damping adds: it acts on the speed half a step later,
    which is the damping of half a step's acceleration. At least half the armature is left."""
    return max(servo.armature - spec.option.timestep / 2 * servo.damping, servo.armature / 2)


def _add_servo(spec: mujoco.MjSpec, fish: Fish, servo: Servo, replayed: bool) -> None:
    """Position servo. `delay` may be any time; the command is interpolated between steps.

    Half a step is added: the engine's speeds belong to the middles of its steps, so a command that
    acted for the whole step would act half a step early. A servo without delay has no buffer.
    """
    actuator = spec.add_actuator(name="servo", target="motor")
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.set_to_position(kp=servo.kp, kv=servo.kv)
    actuator.forcelimited = True
    actuator.forcerange = [-servo.force_limit, servo.force_limit]
    if fish.motor.range is not None and not replayed:
        actuator.ctrllimited = True
        actuator.ctrlrange = list(fish.motor.range)
    if servo.delay > 0:
        actuator.delay = servo.delay + spec.option.timestep / 2
        actuator.nsample = int(np.ceil(actuator.delay / spec.option.timestep)) + 2
        actuator.interp = 1  # linear: a delay between two whole steps is exact on average


def _add_tendons(spec: mujoco.MjSpec, fish: Fish) -> None:
    for side, sign in (("left", 1), ("right", -1)):
        tendon = spec.add_tendon(name=side, width=0.001, rgba=[0.9, 0.8, 0.2, 1])
        tendon.wrap_site(f"anchor-{side}")
        if fish.motor.kind == "pulley":
            _wrap_pulley(spec, tendon, fish, side, sign)
        for name in _guide_sites(spec, fish, side, sign):
            tendon.wrap_site(name)
    _set_elasticity(spec, fish)


def _wrap_pulley(
    spec: mujoco.MjSpec, tendon: mujoco.MjsTendon, fish: Fish, side: str, sign: int
) -> None:
    """Wrap the tendon around its own side of the pulley."""
    spec.body("motor").add_site(name=f"side-{side}", pos=[0, sign * 2 * fish.motor.radius, 0])
    tendon.wrap_geom("pulley", f"side-{side}")


def _guide_sites(spec: mujoco.MjSpec, fish: Fish, side: str, sign: int) -> list[str]:
    """Add the guide sites of one tendon, head first, and return their names."""
    names = []
    places = [("head", 0.0, sign, fish.tendons.head_guides)]
    for index, link in enumerate(fish.tail.links):
        swapped = -sign if link.crossed else sign
        places.append((f"link{index}", link.hinge, swapped, link.guides))
    for body, x0, y_sign, guides in places:
        for index, (x, y) in enumerate(guides):
            names.append(f"{body}-{side}{index}")
            spec.body(body).add_site(name=names[-1], pos=[x - x0, y_sign * y, 0], size=[0.002] * 3)
    return names


def _set_elasticity(spec: mujoco.MjSpec, fish: Fish) -> None:
    """Springs (see `_set_slack`), or one constraint that ties the pair.

    The constraint is: change of left length = change of right length. Two separate constraints of
    zero change would block the second-order change of length when the tail bends.
    """
    elasticity = fish.tendons
    if elasticity.stiffness is None:
        tie = spec.add_equality(name="tendons", type=mujoco.mjtEq.mjEQ_TENDON)
        tie.objtype = mujoco.mjtObj.mjOBJ_TENDON
        tie.name1, tie.name2, tie.data[:5] = "left", "right", [0, 1, 0, 0, 0]
        tie.solref, tie.solimp[:3] = TAUT_SOLREF, TAUT_SOLIMP
        return
    for tendon in spec.tendons:
        tendon.stiffness[0], tendon.damping[0] = elasticity.stiffness, elasticity.damping


def _set_slack(fish: Fish, model: mujoco.MjModel) -> None:
    """Set each tendon's free length: its length in the straight pose plus the slack. A shorter
    tendon has no force, unless the tendons are `two_way`."""
    longest = model.tendon_length0 + fish.tendons.slack
    model.tendon_lengthspring[:, 0] = longest if fish.tendons.two_way else 0.0
    model.tendon_lengthspring[:, 1] = longest
