"""A sketched fish as the text of a TOML file in which every number that nobody measured says so."""

import math

from tailbeat.fish.catalogue import STALL_SHARE, Profile
from tailbeat.fish.convergence import OURS
from tailbeat.fish.description import COEFFICIENTS, Simulation
from tailbeat.fish.proportions import Box, Segment, Sketch

COLUMN = 29  # where comments begin
FRONT = """\
# {name}: sketched from {given}.
#
# Every number marked "assumed" has the pulley fish's proportions; nobody measured it. Measure it,
# write it here with its source, and look again with `tailbeat show {name}.toml`.
# Frame: x towards the nose, y left, z up, at the straight pose.

name = "{name}"
summary = "{hinges} hinges, {length} mm, {mass} g, {model}; sketched, not measured"
servo = "{servo}"
band = "{low} {high} Hz"      # assumed: falls with the square root of the length; what servo allows
tracked = "{tracked} mm"      # assumed: the tag's centre, on top of the shell
tag = "{tag} mm"              # fits on the shell; print it with `tailbeat tags --fish {name}.toml`
added_inertia = 1.0
added_along = 0.25            # assumed: as identified for the pulley fish

[simulation]                  # the longest step within {error} of one of 0.25 ms
step = {{ value = {step}, unit = "ms", source = "{source}" }}
integrator = "{integrator}"

[trailing_edge]               # assumed; identified from launched swims
speed = "0.005 m/s"
reverse = -0.47

[medium]
density = "1000 kg/m^3"
viscosity = "1 mPa s"

# Five coefficients per zone, assumed: as identified for the pulley fish in the virtual pool. With
# them, sketches of 0.28 to 1 m swim within 20 % of their speed there. Identify yours.
"""
ZONE = """\
[zones.{name}]
blunt = {blunt}
slender = {slender}
angular = {angular}
kutta = {kutta}
magnus = {magnus}

"""
ZONES = {  # in the order of `COEFFICIENTS`
    "head": (0.026, 0.19, 6.8, 2.2, 3.3),
    "tail": (0.02, 0.0056, 1.6, 6.3, 0.035),
    "fin": (0.24, 0.057, 9.0, 1.4, 53.0),
}
MACHINE = """\
[motor]
kind = "pulley"
position = "{motor} 0 0 mm"   # assumed
radius = "{radius} mm"        # assumed
mass = "{motor_mass} g"       # assumed
range = "-80 80 deg"          # assumed: the tendons stay on the pulley

[servos.{servo}]              # from the maker's numbers: {model}, {volts} V, {stall} N m, {rpm} rpm
kp = "{kp} N m/rad"           # assumed: gain register {gain}
kv = "0 N m s/rad"            # assumed
armature = "{armature} kg m^2"  # assumed: {tau} ms of damping
damping = "{damping} N m s/rad" # assumed: stall torque over no-load speed
force_limit = "{stall} N m"   # printed stall torque
delay = "{delay} ms"          # assumed

{hardware}[tendons]                     # without stiffness the pair is inextensible
head_guides = ["{guide} mm"]  # assumed

[head]
"""
HARDWARE = """\
[hardware]                    # by its maker's manual; driver, emulator and safety limits read it
family = "{family}"      # which driver speaks to it
make = "{make}"
model = "{model}"
number = {number}             # what the servo reports as its model
supply = "{supply} V"         # assumed: write your battery's
supply_range = "{low} {high} V" # beyond, the servo reports an error
current_unit = "{current_unit} mA" # {reading}
current_limit = "{current_limit} A" # {share} of the stall current
temperature_limit = "{temperature_limit} degC"
gain = {gain}                 # of its position loop, as shipped
imu_up = "{imu_up}"                  # axis of the IMU that points up: x, -x, y, -y, z or -z

"""
PART = """\
[[head.parts]]
name = "{name}"               # {note}
position = "{x} 0 0 mm"       # assumed
size = "{size} mm"            # assumed
mass = "{mass} g"             # assumed
added_mass = "{added} g"      # slender body: density pi/4 height^2 length
zone = "head"
flooded = {flooded}

"""
TAIL = """\
[tail]
k_eff = "{k_eff} N m/rad"     # {source}
damping_time = "10 ms"        # assumed

"""
LINK = """\
[[tail.links]]
hinge = "{hinge} mm"          # assumed
stiffness = "{stiffness} N m/rad" # assumed; together they give k_eff
strip_height = "{height} mm"  # assumed
strip_length = "{long} mm"    # assumed
guides = [{guides}]           # assumed: arm {arm} mm
parts = [
{parts}
]

"""
BOX = '  {{ name = "{name}", position = "{x} 0 0 mm", size = "{size} mm", mass = "{mass} g", zone = "{zone}", added_mass = "{added} g", flooded = true }},'  # noqa: E501
MARKER = """\
[[markers]]
name = "{name}"
body = {body}
position = "{place} mm"       # assumed

"""


def text_of(name: str, sketch: Sketch, simulation: Simulation, error: float) -> str:
    """The file's text, with the step and integrator that a convergence run chose, and the `error`
    of that step."""
    head = _part("shell", sketch.shell, "sealed; holds electronics and battery", False)
    head += _part("mid-body", sketch.mid, "holds the servo", True)
    zones = "".join(
        ZONE.format(name=zone, **dict(zip(COEFFICIENTS, row, strict=True)))
        for zone, row in ZONES.items()
    )
    parts = (
        _front(name, sketch, simulation, error),
        zones,
        _machine(sketch),
        head,
        _tail(sketch),
        _markers(sketch),
    )
    return "\n".join(map(_aligned, "".join(parts).split("\n")))


def _aligned(line: str) -> str:
    """The line with its comment at a fixed column."""
    value, mark, comment = line.partition(" # ")
    if line.startswith("#") or not mark:
        return line
    return f"{value.rstrip():<{COLUMN}} # {comment.strip()}"


def _front(name: str, sketch: Sketch, simulation: Simulation, error: float) -> str:
    given = sketch.given
    top = 1e3 * (sketch.shell.size[2] / 2 + 5e-3)
    return FRONT.format(
        name=name,
        given=_given(sketch),
        tag=_mm(sketch.tag),
        hinges=given.hinges,
        length=_mm(given.length),
        mass=_grams(given.mass),
        model=sketch.profile.model,
        servo=sketch.profile.name,
        low=_number(sketch.band[0]),
        high=_number(sketch.band[1]),
        tracked=f"{_number(40 * sketch.scale)} 0 {_number(top)}",
        step=_number(1e3 * simulation.step),
        source=f"{OURS} of the sketch",
        integrator=simulation.integrator,
        error=f"{100 * error:.1f} %",
    )


def _given(sketch: Sketch) -> str:
    given = sketch.given
    words = [f"{_mm(given.length)} mm", f"{_grams(given.mass)} g", f"{given.hinges} hinges"]
    words.append(f"servo {sketch.profile.name}")
    if given.fin is not None:
        words.append(f"fin {_mm(given.fin[0])}x{_mm(given.fin[1])} mm")
    if given.k_eff is not None:
        words.append(f"k_eff {_number(given.k_eff)} N m/rad")
    return ", ".join(words)


def _machine(sketch: Sketch) -> str:
    servo, profile, first = sketch.profile.servo(), sketch.profile, sketch.tail[0]
    return MACHINE.format(
        motor=_number(-60 * sketch.scale),
        radius=_mm(sketch.radius),
        motor_mass=_grams(sketch.motor_mass),
        servo=profile.name,
        model=profile.model,
        volts=_number(profile.voltage_v),
        stall=_number(servo.force_limit),
        rpm=_number(profile.no_load_rpm),
        gain=_number(profile.gain),
        kp=_number(servo.kp),
        armature=_number(servo.armature),
        damping=_number(servo.damping),
        tau=_number(1e3 * servo.armature / servo.damping),
        delay=_number(1e3 * servo.delay),
        guide=f"{_mm(first.hinge + first.gap)} {_mm(first.arm)}",
        hardware=_hardware(profile),
    )


def _hardware(profile: Profile) -> str:
    own = profile.hardware()
    if own is None:
        return "# No [hardware] table: tailbeat has no driver for this maker's servos yet.\n\n"
    numbers = own.model_dump(exclude={"supply_range", "current_unit"})
    return HARDWARE.format(
        **numbers,
        low=_number(own.supply_range[0]),
        high=_number(own.supply_range[1]),
        current_unit=_number(1e3 * own.current_unit),
        reading="of one count" if profile.current_ma else "of a thousandth: it reports a load",
        share=STALL_SHARE,
    )


def _part(name: str, box: Box, note: str, flooded: bool) -> str:
    return PART.format(name=name, note=note, flooded=str(flooded).lower(), **_box(box))


def _box(box: Box) -> dict[str, str]:
    return {
        "x": _mm(box.x),
        "size": " ".join(map(_mm, box.size)),
        "mass": _grams(box.mass),
        "added": _grams(box.added_mass),
    }


def _tail(sketch: Sketch) -> str:
    given = sketch.given.k_eff is not None
    source = "as given" if given else "assumed: with the cube of the length, within the servo's"
    links = [_link(sketch, i, link) for i, link in enumerate(sketch.tail)]
    return TAIL.format(k_eff=_number(sketch.k_eff), source=source) + "".join(links)


def _link(sketch: Sketch, i: int, link: Segment) -> str:
    boxes = [BOX.format(name=f"tail{i}", zone="tail", **_box(link.box))]
    if i == len(sketch.tail) - 1:
        boxes.append(BOX.format(name="fin", zone="fin", **_box(sketch.fin)))
    places = [(link.hinge - link.gap, link.arm)]
    places += [link.guide] if link.guide is not None else []
    return LINK.format(
        hinge=_mm(link.hinge),
        stiffness=_number(link.stiffness),
        height=_mm(link.strip[0]),
        long=_mm(link.strip[1]),
        guides=", ".join(f'"{_mm(x)} {_mm(y)} mm"' for x, y in places),
        arm=_mm(link.arm),
        parts="\n".join(boxes),
    )


def _markers(sketch: Sketch) -> str:
    last, top = len(sketch.tail) - 1, 1e3 * (sketch.shell.size[2] / 2 + 5e-3)
    tip = sketch.fin.x - sketch.fin.size[0] / 2
    places = {
        "0": ('"head"', f"{_number(80 * sketch.scale)} 0 {_number(top)}"),
        "1": ('"head"', f"0 0 {_number(top)}"),
        "2": (str(last), f"{_mm(tip)} 0 0"),
    }
    rows = [
        MARKER.format(name=name, body=body, place=place) for name, (body, place) in places.items()
    ]
    return "".join(rows).rstrip("\n") + "\n"


def _mm(metres: float) -> str:
    return _number(1e3 * metres)


def _grams(kilograms: float) -> str:
    return _number(1e3 * kilograms)


def _number(value: float) -> str:
    """Four significant digits, without an exponent."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = max(3 - math.floor(math.log10(abs(value))), 0)
    return (
        f"{round(value, digits):.{digits}f}".rstrip("0").rstrip(".") if digits else f"{value:.0f}"
    )
