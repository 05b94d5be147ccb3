"""A fish as numbers: TOML read into frozen, validated models.

Every position is in the fish frame at the straight pose: x towards the nose, y left, z up, with one
common origin that the author chooses. Everything is SI inside; a file may use any unit of
`units.UNITS`. `twin.py` compiles it for the engine.
"""

from typing import Literal

from pydantic import Field, field_validator, model_validator

from tailbeat.fish import bodies as b
from tailbeat.fish import units as u
from tailbeat.fish.bodies import Body, Link, Model, Part
from tailbeat.fish.lab import Lab

# Of a servo: which driver and which table speak to it.
Family = Literal["dynamixel-x", "dynamixel-p", "feetech-sts", "feetech-scs"]
PERIOD = 0.02  # s, of the robot's loop
FIN_ZONE = "fin"  # its parts are fins: they carry circulation in the pool
COEFFICIENTS = ("blunt", "slender", "angular", "kutta", "magnus")  # the engine's order


class Medium(Model):
    """The water."""

    density: u.Density = Field(gt=0)
    """Density of the water."""
    viscosity: u.Viscosity = Field(ge=0)
    """Dynamic viscosity of the water."""


class Simulation(Model):
    """Step and integrator of the engine; docs/explain/twin.md says why these are the defaults."""

    step: u.Time = Field(default=0.002, gt=0, le=0.02)
    """Time step of the engine. It divides the 20 ms of the robot's loop."""
    integrator: Literal["implicit", "implicitfast", "Euler", "RK4"] = "implicit"
    """Integrator of the engine."""

    @field_validator("step")
    @classmethod
    def _divides(cls, step: float) -> float:
        if abs(round(PERIOD / step) * step - PERIOD) > 1e-9:
            raise ValueError(
                "the step must divide the 20 ms of the robot's loop, as 1, 2, 4 or 5 ms do"
            )
        return step


class Zone(Model):
    """Five coefficients for the parts that name this zone; see docs/explain/fluid-law.md."""

    blunt: u.Ratio = Field(ge=0)
    """Pressure drag of what faces the flow. There is no 1/2 in the law."""
    slender: u.Ratio = Field(ge=0)
    """Drag of what lies along the flow. It enters angular drag too."""
    angular: u.Ratio = Field(ge=0)
    """Drag that opposes rotation."""
    kutta: u.Ratio = Field(ge=0)
    """Lift of a plate at incidence, at right angles to the flow."""
    magnus: u.Ratio = Field(ge=0)
    """Lift of a part that turns while it moves."""

    def row(self) -> tuple[float, ...]:
        """The five numbers in the engine's order."""
        return tuple(getattr(self, name) for name in COEFFICIENTS)


class TrailingEdge(Model):
    """Only the rear end of a wet part sheds circulation (`edge.py`)."""

    speed: u.Speed = Field(default=0.03, gt=0, le=0.5)
    """Flow along the chord over which the lift ahead and the lift astern are blended."""
    reverse: u.Ratio = Field(default=-1.0, ge=-1, le=1)
    """Lift astern over the lift ahead. 1 is the bare engine, and 0 is no lift astern. With -1 the
    rear end keeps its circulation in either direction of the flow."""


class Motor(Model):
    """What moves the tendons."""

    kind: Literal["pulley", "crank"]
    """A `pulley` turns about the vertical axis and winds one tendon while it pays out the other. A
    `crank` turns about the transverse axis, has one arm per side, 180 degrees apart, and may turn
    without end."""
    position: u.Point3
    """Place of the axis."""
    radius: u.Length = Field(gt=0)
    """Radius of the pulley or of the crank."""
    half_width: u.Length = Field(default=0.0, ge=0)
    """Distance of the crank's arms from the midplane, |y|."""
    mass: u.Mass = Field(default=0.0, ge=0)
    """Mass of pulley and horn."""
    range: u.AngleRange | None = None
    """Lowest and highest angle, within -85 to 85 deg. A pulley needs it."""


class Servo(Model):
    """Position servo: torque = kp (command(t - delay) - angle) - kv speed, within the limit."""

    kp: u.AngularStiffness = Field(gt=0)
    """Gain on the angle's error."""
    kv: u.AngularDamping = Field(ge=0)
    """Gain on the shaft's speed."""
    armature: u.Inertia = Field(gt=0)
    """Inertia of rotor and gears at the shaft."""
    damping: u.AngularDamping = Field(ge=0)
    """Viscous damping on the shaft."""
    friction: u.Torque = Field(default=0.0, ge=0)
    """Coulomb friction on the shaft."""
    force_limit: u.Torque = Field(gt=0)
    """Largest torque."""
    delay: u.Time = Field(ge=0, le=0.2)
    """Time from a command to its effect."""


class Hardware(Model):
    """The servo as bought, and how the IMU is mounted. Drivers, emulators and the robot's limits
    read this; the twin does not, so an identification may not change it and a policy does not
    depend on it."""

    family: Family = "dynamixel-x"
    """Which driver speaks to it. `dynamixel-x`: ROBOTIS Protocol 2.0 with the addresses of the X
    series (without the XL-320) and the MX-28 (2.0). `dynamixel-p`: those of the P series (PM42,
    PM54, PH42, PH54). `feetech-sts`, `feetech-scs`: Feetech's STS and SCS servos, which have no bus
    watchdog."""
    make: str
    """Maker."""
    model: str
    """Model, as its maker writes it."""
    number: int = Field(ge=0, le=0xFFFF)
    """Model number, as the servo itself reports it (a Dynamixel in register 0, an STS in 3)."""
    supply: u.Voltage = Field(gt=0)
    """Supply that the fish has."""
    supply_range: u.VoltageRange
    """Lowest and highest supply, beyond which the servo reports an error."""
    current_unit: u.Current = Field(gt=0)
    """Current of one count of register 126 (Dynamixel X), 574 (P) or 69 (STS). For a servo
    that reports a load instead, in thousandths of its output: a thousandth of its stall current, so
    that currents are estimates."""
    current_limit: u.Current = Field(gt=0)
    """Mean absolute current over a beat at which the robot stops."""
    temperature_limit: u.Temperature = Field(gt=20, le=120)
    """Temperature at which the servo shuts down. The robot holds 15 degrees below, and stops 5
    degrees below."""
    gain: int = Field(ge=0, le=16383)
    """Position P gain with which it was identified: register 84 (Dynamixel X), 532 (P) or 21
    (STS)."""
    imu_up: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"
    """Axis of the IMU that points up."""
    imu_rotation: u.Angles3 | None = None
    """Instead of `imu_up`, for any mounting: the IMU's roll, pitch and yaw in the fish's axes (x
    ahead, y left, z up). It is turned about the fish's own x, then y, then z axis, as `rpy` in
    URDF."""

    @model_validator(mode="after")
    def _mounted_once(self) -> "Hardware":
        if self.imu_rotation is not None and self.imu_up != "z":
            raise ValueError("imu_up and imu_rotation both say how the IMU is mounted; give one")
        return self


class Tendons(Model):
    """The antagonistic pair. Without `stiffness` it is inextensible (a constraint). With it, each
    tendon is a spring that pulls and never pushes."""

    stiffness: u.LinearStiffness | None = Field(default=None, gt=0)
    """Stiffness of one tendon."""
    damping: u.LinearDamping = Field(default=0.0, ge=0)
    """Damping of one tendon."""
    slack: u.Length = Field(default=0.0, ge=0)
    """Length beyond the rest length at which a tendon begins to pull. It needs `stiffness`."""
    two_way: bool = False
    """Whether a tendon pushes too. It needs `stiffness`."""
    head_guides: u.Points2 = ()
    """Holes (x, y) of the left tendon in the head. The right tendon's are the mirror image."""


class Tail(Model):
    """The chain of links."""

    k_eff: u.AngularStiffness | None = Field(default=None, gt=0)
    """Stiffness at the shaft that the hinges must give together."""
    stiffness_scale: u.Ratio = Field(default=1.0, gt=0)
    """Factor on the stiffness of every hinge."""
    damping_time: u.Time = Field(default=0.0, ge=0)
    """Damping over stiffness, the same in every hinge."""
    friction: u.Torque = Field(default=0.0, ge=0)
    """Coulomb friction of tail and tendons at the shaft."""
    links: tuple[Link, ...] = Field(min_length=1)
    """Links from the head to the fin."""


class Marker(Model):
    """A point that a camera follows."""

    name: str
    """Number of the marker, as in a recording's columns `marker0_x_m`, `marker0_y_m`."""
    body: Literal["head"] | int
    """Body that carries the marker: `head`, or the index of a link, from 0."""
    position: u.Point3
    """Place of the marker."""


class Uncertain(Model):
    """A number that no test bench measured and the fluid fit may move."""

    field: str
    """Dotted path of the number, such as `tendons.slack`."""
    unit: str
    """SI unit of the number, for tables."""
    low: float
    """Lowest value that the fit may try, in SI."""
    high: float
    """Highest value that the fit may try, in SI."""
    spread: float = Field(gt=0)
    """Standard deviation of the prior: of ln(value) with `log`, else in SI."""
    log: bool = True
    """Whether the fit searches ln(value)."""


class Fish(Model):
    """The whole fish. Everything is SI."""

    name: str
    """Name of the fish."""
    summary: str = ""
    """One line about the fish, for tables."""
    medium: Medium
    """Water around the fish."""
    simulation: Simulation = Simulation()
    """Step and integrator."""
    band: u.FrequencyRange
    """Lowest and highest beat frequency that the description is meant for."""
    zones: dict[str, Zone]
    """Fluid coefficients by the zone's name."""
    head: Body
    """The rigid front of the fish."""
    motor: Motor
    """Pulley or crank."""
    servo: str
    """Name of the servo in `servos` that drives the motor."""
    servos: dict[str, Servo]
    """Servos by name."""
    hardware: Hardware | None = None
    """Maker's numbers of the servo. Without them, the driver takes it for an XW430-T200."""
    lab: Lab | None = None
    """How exactly the lab builds and measures, for its policies' margins."""
    tendons: Tendons = Tendons()
    """The pair of tendons."""
    tail: Tail
    """Links, hinges and friction."""
    markers: tuple[Marker, ...] = ()
    """Points that a camera follows."""
    tracked: u.Point3 = (0.0, 0.0, 0.0)
    """Point whose pose recordings hold."""
    tag: u.Length | None = Field(default=None, gt=0)
    """Side of the black square of the fish's tag, whose centre is at `tracked`. Without it, the
    paper's 80 mm. The twin does not read it."""
    uncertain: tuple[Uncertain, ...] = ()
    """Numbers that the fluid fit may move beside the coefficients."""
    added_inertia: u.Ratio = Field(default=0.0, ge=0)
    """Factor on the parts' `added_mass`. 0 turns it off."""
    added_along: u.Ratio = Field(default=1.0, ge=0, le=1)
    """Fraction of the added mass that acts along the parts too. With 1 it is the same in all
    directions."""
    trailing_edge: TrailingEdge | None = None
    """How lift depends on the direction of the flow. Without it, front and rear end of each part
    are equivalent, as in the bare engine and the paper."""

    @model_validator(mode="after")
    def _consistent(self) -> "Fish":
        for complaint in (*_name_errors(self), *_geometry_errors(self)):
            raise ValueError(complaint)
        return self


def parts_of(fish: Fish) -> list[Part]:
    """Every part of head and links, from nose to fin."""
    return [part for body in (fish.head, *fish.tail.links) for part in body.parts]


def ends_of(fish: Fish) -> tuple[float, float]:
    """x of the rear of the rearmost part and of the front of the foremost part [m]."""
    return b.ends((fish.head, *fish.tail.links))


def length_of(fish: Fish) -> float:
    """Length from the front of the foremost part to the rear of the rearmost part [m]."""
    rear, front = ends_of(fish)
    return front - rear


def _name_errors(fish: Fish) -> list[str]:
    """Names of zones, servos and links that do not exist."""
    zones, links = ", ".join(fish.zones), len(fish.tail.links)
    found = b.repeated("part", [one.name for one in parts_of(fish) if one.zone is not None])
    found += b.repeated("marker", [one.name for one in fish.markers])
    if fish.servo not in fish.servos:
        found.append(f"servo {fish.servo!r} is not one of {', '.join(fish.servos)}")
    for part in parts_of(fish):
        if part.zone is not None and part.zone not in fish.zones:
            found.append(
                f"part {part.name!r} names zone {part.zone!r}, which is not one of {zones}"
            )
    for marker in fish.markers:
        if marker.body != "head" and not 0 <= marker.body < links:
            found.append(
                f"marker {marker.name!r} is on link {marker.body}; links are 0 to {links - 1}"
            )
    return found


def _geometry_errors(fish: Fish) -> list[str]:
    """Impossible shapes: hinges out of order, an empty band, a pulley that unwinds."""
    bodies = (fish.head, *fish.tail.links)
    places = {f"markers.{i}.position": one.position for i, one in enumerate(fish.markers)}
    places |= {"tracked": fish.tracked, "motor.position": fish.motor.position}
    found = [*b.hinge_errors(bodies, fish.tail.links), *b.mass_errors(bodies)]
    found += [*b.place_errors(bodies, places), *b.tag_errors(fish.head, fish.tag)]
    if (own := fish.hardware) and not own.supply_range[0] <= own.supply <= own.supply_range[1]:
        low, high = own.supply_range
        found.append(f"hardware.supply is {own.supply:g} V; the servo takes {low:g} to {high:g} V")
    if not 0 <= fish.band[0] < fish.band[1]:
        found.append(f"band {list(fish.band)} must rise from a frequency of 0 or more [Hz]")
    if fish.motor.kind == "pulley" and fish.motor.range is None:
        found.append("a pulley needs motor.range, within -85 to 85 deg")
    if fish.motor.range is not None and not fish.motor.range[0] < fish.motor.range[1]:
        found.append("motor.range must rise, as -80 80 deg does")
    if fish.motor.range is not None and max(map(abs, fish.motor.range)) > 1.4836:
        found.append(
            "motor.range must lie within -85 to 85 deg: beyond, the tendon leaves the pulley"
        )
    if fish.trailing_edge is not None:
        found += b.chord_errors(bodies)
    if fish.tendons.stiffness is None and (fish.tendons.slack or fish.tendons.two_way):
        found.append("tendons.slack and two_way need a tendons.stiffness")
    return found
