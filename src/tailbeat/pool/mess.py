"""The messy pool: what labs get wrong, each with an everyday size and its source.

A `Lab` is one drawing of it: one robot in one pool, constant over its swims. All is off by default.
The sizes are a lab's and do not grow with the fish. They are frozen by `fingerprint`;
docs/explain/messy-labs.md says what was swum before.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.env.errors import BURSTS, Errors, true_frame
from tailbeat.env.hardship import Hardship
from tailbeat.env.randomize import Randomisation
from tailbeat.files import BadInput
from tailbeat.fish.lab import Lab as Figures
from tailbeat.fish.store import lab_in
from tailbeat.pool.dynamics import FADING
from tailbeat.pool.plant import Surroundings, stirred
from tailbeat.pool.water import Water
from tailbeat.pool.wear import Wear

Array = NDArray[np.float64]
Sizes = Mapping[str, float]  # of nuisances by name, each in its own unit; one left out is 0

# SI per unit.
UNITS = {
    "deg": np.pi / 180, "%": 0.01, "mm": 1e-3, "N m": 1.0, "ms": 1e-3, "cm/s": 0.01, "N": 1.0,
    "N s²/m²": 1.0, "rad/s": 1.0,
}  # fmt: skip


@dataclass(frozen=True)
class Nuisance:
    """One thing that a lab gets wrong: its everyday size and the largest that can be simulated, in
    `unit`, what it is, and where the size comes from."""

    name: str
    unit: str
    everyday: float
    most: float
    what: str
    source: str


AUDIT = "an outside audit's messy lab"
# A size in % is a factor: 20 % is 1.2 or 1 / 1.2; of what only gets less, 1 / 1.2.
NUISANCES = (
    Nuisance("horn", "deg", 5, 60, "servo horn off its tooth or its zero", AUDIT),
    Nuisance("bend", "deg", 5, 120, "tail at rest is bent", "chosen: warped print or glue"),
    Nuisance("slack", "deg", 3, 60, "slack tendons and backlash, either way", AUDIT),
    Nuisance("sticking", "deg", 3, 120, "loose tail stays bent (hysteresis)", "chosen"),
    Nuisance("stiffness", "%", 20, 900, "tail stiffer or softer", AUDIT),
    Nuisance("damping", "%", 30, 900, "tail's damping", "chosen: plastic from 15 to 25 °C"),
    Nuisance("friction", "N m", 0.1, 1.5, "friction at the shaft", AUDIT),
    Nuisance("mass", "%", 15, 300, "mass and inertia of the bodies", AUDIT),
    Nuisance("centre", "mm", 5, 100, "ballast ahead or astern", "paper's range in training"),
    Nuisance("fin", "%", 15, 300, "fin higher or lower", AUDIT),
    Nuisance("added mass", "%", 15, 300, "water that the body carries", "chosen: strip theory"),
    Nuisance("servo gain", "%", 20, 900, "gain of the servo", AUDIT),
    Nuisance("servo torque", "%", 20, 900, "largest torque of the servo", AUDIT),
    Nuisance("servo delay", "ms", 5, 150, "servo slower", "chosen: another bus rate"),
    Nuisance("fading", "%", 12, 900, "servo weaker over minutes", "battery, 12.6 to 11.1 V"),
    Nuisance("current", "cm/s", 3, 60, "steady current", AUDIT),
    Nuisance("stirring", "cm/s", 2, 60, "slow eddies, rms", "chosen: a pump or the swim before"),
    Nuisance("tether pull", "N", 0.02, 3, "steady pull of a tether", "1 m of 3 mm cable in water"),
    Nuisance("tether drag", "N s²/m²", 0.5, 100, "drag of a tether", "chosen: 3 mm, 0.3 m across"),
    Nuisance("tag askew", "deg", 5, 120, "tag glued at an angle", AUDIT),
    Nuisance("tag ahead", "mm", 20, 500, "tag glued ahead or astern", AUDIT),
    Nuisance("tag sideways", "mm", 10, 500, "tag glued sideways", AUDIT),
    Nuisance("scale", "%", 3, 300, "scale of the camera's positions", AUDIT),
    Nuisance("rotation", "deg", 3, 180, "camera's frame turned", "chosen: sheet laid by eye"),
    Nuisance("lens", "mm", 20, 500, "error of the lens 2 m from the middle", "chosen"),
    Nuisance("latency", "ms", 20, 150, "camera later than the contract", "chosen: one frame"),
    Nuisance("hidden", "ms", 60, 5000, "bursts of lost frames, one a second", AUDIT),
    Nuisance("gyro bias", "rad/s", 0.1, 10, "bias of the yaw rate", AUDIT),
    Nuisance("gyro drift", "rad/s", 0.05, 10, "drift in a swim", "chosen: warm-up of a MEMS gyro"),
    Nuisance("encoder", "deg", 2, 120, "reading of the shaft alone is off", "chosen"),
)  # fmt: skip
BY_NAME = {one.name: one for one in NUISANCES}
LEVELS = {"clean": 0.0, "everyday": 1.0, "rough": 2.0, "wrecked": 3.0}
MOST_ROBOTS = 0.85  # fraction of a training's episodes with a hardship (chosen)
FULL_SIZE = 0.5  # fraction of these in which all have their full size, as in a lab (chosen)
FAR_OFF = 4.0  # m, farthest target beside hardships: most of a pool's length (chosen)
EDGE = 2.0  # m from the middle, where the size of `lens` is meant


@dataclass(frozen=True)
class Lab:
    """One robot in one pool: its wear and errors, the factor on added mass, its flow and tether
    (as in `Surroundings`)."""

    wear: Wear = field(default_factory=Wear)
    errors: Errors = field(default_factory=Errors)
    added_mass: float = 1.0
    modes: tuple[tuple[float, ...], ...] = ()
    tether: tuple[float, float, float] = (0.0, 0.0, 0.0)


AS_DESCRIBED = Lab()


def on_the_bench(wear: Wear) -> Wear:
    """The wear of a tail that a test bench's own drive turns, without the servo's."""
    return replace(wear, gain=1.0, limit=1.0, delay=0.0, fade=0.0)


def level(name: str) -> Sizes:
    """Sizes of a named level, or of the table `[lab]` in a TOML file: what it leaves out is 0.
    Raises BadInput."""
    if name.endswith(".toml"):
        return of_figures(lab_in(Path(name)), name)
    if name not in LEVELS:
        raise BadInput(
            f"mess {name!r}: allowed are {', '.join(LEVELS)}, or a TOML file with a table [lab]."
        )
    return times(LEVELS[name])


def of_figures(figures: Figures, where: str) -> Sizes:
    """A lab's own figures, of the file or fish `where`, as sizes. Raises BadInput for one that is
    larger than what can be simulated, as a number without a unit may be."""
    found = {}
    for field_, value in figures.model_dump(exclude_none=True).items():
        one = BY_NAME[field_.replace("_", " ")]
        size = found[one.name] = value / UNITS[one.unit]
        if size > one.most * (1 + 1e-9):  # 60 deg comes back rounded
            unit = one.unit.replace("²", "^2")  # as a file has it
            raise BadInput(
                f"{where}: lab.{field_} is {size:.4g} {unit}; allowed is up to {one.most:g} {unit}."
                f' Give it with its unit, such as "{one.everyday:g} {unit}".'
            )
    return {name: min(size, BY_NAME[name].most) for name, size in found.items()}


def times(factor: float) -> Sizes:
    """So many times the everyday sizes, none above the largest."""
    return {one.name: min(factor * one.everyday, one.most) for one in NUISANCES}


def check(sizes: Sizes) -> None:
    """Raises BadInput for an unknown nuisance, or a size below 0 or above the largest."""
    for name, size in sizes.items():
        if (one := BY_NAME.get(name)) is None:
            near = get_close_matches(name, BY_NAME, n=1) or BY_NAME
            raise BadInput(f"nuisance {name!r}: give {', '.join(near)}.")
        if not 0 <= size <= one.most:
            raise BadInput(
                f"nuisance {name}: {size:g} {one.unit}; allowed is 0 to {one.most:g} {one.unit}."
            )


def _si(sizes: Sizes) -> Sizes:
    """Sizes of all nuisances in SI. Raises BadInput."""
    check(sizes)
    return {one.name: sizes.get(one.name, 0.0) * UNITS[one.unit] for one in NUISANCES}


def widths(sizes: Sizes) -> Errors:
    """Half widths for a training of what a robot has wrong: of all errors but those of the camera's
    frame, in which relabelled targets would be wrong."""
    size = _si(sizes)
    return true_frame(_errors(size, size))


def build(sizes: Sizes) -> Randomisation:
    """Half widths for a training of how wrong a fish is built, and of the current: these sizes, or
    the usual ranges where those are wider. A lab multiplies by 1 + size or divides by it; a
    training draws up to a size either way."""
    size, usual = _si(sizes), vars(Randomisation())
    own = {
        "head_mass": size["mass"],
        "head_inertia": size["mass"],
        "head_centre": size["centre"],
        "tail_stiffness": size["stiffness"],
        "tail_damping": size["damping"],
        "fluid": max(size["fin"], size["added mass"]),
        "servo_gain": size["servo gain"],
        "servo_limit": size["servo torque"],
        "servo_delay": size["servo delay"],
        "current": size["current"],
    }
    return replace(Randomisation(), **{name: max(usual[name], own[name]) for name in own})


def hardship(sizes: Sizes) -> Hardship:
    """Hardships for a training, up to these sizes: of most robots the servo is weaker and softer,
    fades and rubs, the tail is bent, stiffer and sticks, the fins are lower, a tether pulls."""
    size = _si(sizes)
    torque, gain = (
        (1 + size[name]) * (1 + size["fading"]) - 1 for name in ("servo torque", "servo gain")
    )
    own = {n: size[n] for n in ("stiffness", "fin", "friction", "sticking", "bend")}
    pull = size["tether pull"]
    return Hardship(MOST_ROBOTS, FULL_SIZE, FAR_OFF, torque, gain, pull=pull, **own)


def for_training(
    wrong: str, built: str, hard: str
) -> tuple[Errors | None, Randomisation | None, Hardship | None]:
    """What a training draws up to these levels (names or files): its `errors`, `build` and `hard`.
    None, the usual, at the clean level. Raises BadInput."""
    return (
        None if wrong == "clean" else widths(level(wrong)),
        None if built == "clean" else build(level(built)),
        None if hard == "clean" else hardship(level(hard)),
    )


def fingerprint() -> str:
    """Hash of the sizes and levels."""
    what = [[astuple(one) for one in NUISANCES], LEVELS, BURSTS, FADING, EDGE]
    return hashlib.sha256(json.dumps(what).encode()).hexdigest()[:12]


def named(name: str) -> str:
    """A level's name; a file's with a hash of its sizes, for a file may change."""
    if name in LEVELS:
        return name
    return f"{name} {hashlib.sha256(json.dumps(dict(level(name))).encode()).hexdigest()[:8]}"


def draw(sizes: Sizes, seed: Sequence[int]) -> Lab:
    """A lab whose nuisances have these sizes. Sides and directions are drawn from `seed`, the same
    at every size."""
    size = _si(sizes)
    rng, count = np.random.default_rng(seed), len(NUISANCES)
    side = dict(zip(BY_NAME, rng.choice([-1.0, 1.0], count).tolist(), strict=True))
    angle = dict(zip(BY_NAME, rng.uniform(-np.pi, np.pi, count).tolist(), strict=True))
    either = {name: side[name] * size[name] for name in BY_NAME}
    factor = {name: (1 + size[name]) ** side[name] for name in BY_NAME}
    flow = _steady(size["current"], angle["current"])
    if size["stirring"] > 0:
        flow += stirred(int(rng.integers(2**31)), size["stirring"]).modes
    pull, where = size["tether pull"], angle["tether pull"]
    tether = pull * np.cos(where), pull * np.sin(where), size["tether drag"]
    return Lab(
        _wear(size, either, factor), _errors(size, either), factor["added mass"], flow, tether
    )


def lab_at(name: str, seed: int, number: int = 0) -> Lab:
    """The lab of a level, or of a file, for a swim of this number, drawn from the seed. Raises
    BadInput."""
    return draw(level(name), [seed, number])


def _wear(size: Sizes, either: Sizes, factor: Sizes) -> Wear:
    return Wear(
        bend=either["bend"],
        slack=size["slack"],
        sticking=size["sticking"],
        stiffness=factor["stiffness"],
        damping=factor["damping"],
        mass=factor["mass"],
        centre=either["centre"],
        fin=factor["fin"],
        gain=factor["servo gain"],
        limit=factor["servo torque"],
        delay=size["servo delay"],
        friction=size["friction"],
        fade=1 - 1 / (1 + size["fading"]),
    )


def _errors(size: Sizes, either: Sizes) -> Errors:
    return Errors(
        horn=either["horn"],
        encoder=either["encoder"],
        ahead=either["tag ahead"],
        left=either["tag sideways"],
        askew=either["tag askew"],
        scale=max(either["scale"], -0.9),
        turn=either["rotation"],
        lens=either["lens"] / EDGE**3,
        yaw_rate_bias=either["gyro bias"],
        yaw_rate_drift=either["gyro drift"],
        late=size["latency"],
        dark=size["hidden"],
    )


def _steady(speed: float, angle: float) -> tuple[tuple[float, ...], ...]:
    """A flow that is the same everywhere: a wave of endless length."""
    slow = 1e-9  # 1/m, wave number
    return ((speed, -slow * np.sin(angle), slow * np.cos(angle), 0.0, 0.0),) if speed > 0 else ()


def in_lab(lab: Lab, water: Water, around: Surroundings) -> tuple[Water, Surroundings]:
    """Water and surroundings with a lab's flow and tether."""
    return (
        replace(water, added_mass=water.added_mass * lab.added_mass),
        replace(around, modes=(*around.modes, *lab.modes), tether=lab.tether),
    )
