"""Describe a fish and see what it compiles to."""

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import identified, output
from tailbeat.cli.options import JsonOption
from tailbeat.files import BadInput, need

if TYPE_CHECKING:
    from tailbeat.fish.proportions import Given


def new_fish(
    path: Annotated[Path, typer.Argument(help="TOML file to write.")],
    length: Annotated[
        str | None, typer.Option(help="Length from nose to fin, as 280mm or 0.28 [m].")
    ] = None,
    mass: Annotated[str | None, typer.Option(help="Mass, as 350g or 0.35 [kg].")] = None,
    hinges: Annotated[int | None, typer.Option(help="Number of hinges in the tail (5).")] = None,
    servo: Annotated[str | None, typer.Option(help="Servo of the catalogue (xw430).")] = None,
    fin: Annotated[str | None, typer.Option(help="Chord x span of the fin, as 60x70mm.")] = None,
    k_eff: Annotated[
        str | None, typer.Option("--k-eff", help="Stiffness at the shaft [N m/rad], if measured.")
    ] = None,
    template: Annotated[
        bool, typer.Option("--template", help="Write the commented template; ask nothing.")
    ] = False,
) -> None:
    """Write a fish to start from, from a few measured numbers.

    Without options they are asked for on a terminal; a script gets the commented template."""
    from tailbeat.fish import store

    given = Typed(length, mass, hinges, servo, fin, k_eff)
    if given == Typed() and sys.stdin.isatty() and not template:
        store.check_new_fish(path)
        given = _asked()
    if given == Typed():
        store.new_fish(path)
        output.say(f"wrote {path}; look at it with: tailbeat show {path}")
        return
    need("new-fish with numbers", "mujoco")
    from tailbeat.fish import first_draft

    chosen = first_draft.new_fish(path, _measured(given))
    step = f"step {1e3 * chosen.simulation.step:g} ms, {chosen.simulation.integrator}"
    output.say(f"wrote {path} ({step}); look at it with: tailbeat show {path}")


@dataclass(frozen=True)
class Typed:
    """What was typed for `new-fish`; None: nothing."""

    length: str | None = None
    mass: str | None = None
    hinges: int | None = None
    servo: str | None = None
    fin: str | None = None
    k_eff: str | None = None


def _asked() -> Typed:
    """Ask the five questions; an empty answer takes what stands in brackets."""
    from tailbeat.fish.catalogue import profiles
    from tailbeat.fish.proportions import Given

    return Typed(
        typer.prompt("Length from nose to fin, as 280mm"),
        typer.prompt("Mass, as 350g"),
        typer.prompt("Hinges in the tail", default=Given.hinges, type=int),
        typer.prompt(f"Servo ({', '.join(profiles())})", default=Given.servo),
        typer.prompt("Fin's chord x span, as 60x70mm", default="", show_default=False) or None,
    )


def _measured(given: Typed) -> "Given":
    from tailbeat.fish.proportions import Given

    if given.length is None or given.mass is None:
        lacking = "--length" if given.length is None else "--mass"
        raise BadInput(f"{lacking}: missing; a sketch needs at least a length and a mass.")
    return Given(
        _quantity("--length", given.length, "length"),
        _quantity("--mass", given.mass, "mass"),
        Given.hinges if given.hinges is None else given.hinges,
        given.servo or Given.servo,
        None if given.fin is None else _fin(given.fin),
        None if given.k_eff is None else _quantity("--k-eff", given.k_eff, "angular stiffness"),
    )


def _quantity(option: str, text: str, dimension: str) -> float:
    from tailbeat.fish.units import typed

    try:
        return typed(text, dimension)
    except ValueError as error:
        raise BadInput(f"{option}: {error}.") from None


def _fin(text: str) -> tuple[float, float]:
    """Chord and span [m]; a number without a unit has that of the other."""
    sides = [side.strip() for side in re.split("[xX×]", text)]
    if len(sides) != 2 or not all(sides):
        raise BadInput(f"--fin {text!r}: give chord x span, such as 60x70mm.")
    own = [side.lstrip("0123456789.+-eE ") for side in sides]
    chord, span = (
        _quantity("--fin", side if unit else f"{side}{other}", "length")
        for side, unit, other in zip(sides, own, reversed(own), strict=True)
    )
    return chord, span


def show(
    fish: Annotated[str, typer.Argument(help="A TOML file or a shipped fish's name.")],
    picture: Annotated[Path | None, typer.Option(help="Picture to write, .png.")] = None,
    viewer: Annotated[bool, typer.Option(help="Open MuJoCo's viewer.")] = False,
    strict: Annotated[bool, typer.Option(help="Exit with 1 if there is a warning.")] = False,
    launches: Annotated[
        bool, typer.Option(help="Launch the twin backward and forward in six beats (seconds).")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Print what a fish compiles to and render a picture. Also check it as a marine engineer would.
    With a posterior beside the fish, print which identified numbers its recordings decide."""
    from tailbeat.fish.store import load_fish

    load_fish(fish)  # what is wrong with it is said before the engine is imported
    from tailbeat.fish import show as compiled
    from tailbeat.identify import launch, posterior

    more = launch.tables if launches else lambda fish: {}
    shown = compiled.show(fish, picture, viewer, json, more)
    output.tables({title: [headed(row) for row in rows] for title, rows in shown.tables.items()})
    try:
        if (known := posterior.of(fish)) is not None:
            output.tables({"identified numbers": identified.parameters(posterior.as_rows(known))})
    except BadInput as error:  # the numbers of the file were changed since
        output.say(f"warning: {error}")
    _say_task(fish)
    output.say(f"picture ({shown.how}): {shown.picture}")
    if strict and shown.tables["warnings"]:
        raise typer.Exit(1)


def _say_task(fish: str) -> None:
    """Print the task that a training would give this fish, or why none would."""
    from tailbeat.env.measured import measure_of
    from tailbeat.env.task import Task, sized
    from tailbeat.fish.store import load_fish

    described = load_fish(fish)
    if described.motor.range is None:
        return
    try:
        task = sized(Task(), measure_of(described))
    except BadInput as error:
        output.say(f"no task: {error}")
        return
    row = {"nearest_m": task.nearest, "farthest_m": task.farthest, "arrival_m": task.arrival,
           "time_s": task.seconds, "limit_m": task.limit}  # fmt: skip
    output.tables({"targets of a training": [headed(row)]})


# Units of what `show` prints: by the end of a name, the longest first, and by the name itself.
ENDS = {
    "_n_m_rad": "N m/rad", "_n_m": "N m", "_rad_s": "rad/s", "_kg_m2": "kg m^2", "_m_s": "m/s",
    "_kg": "kg", "_hz": "Hz", "_deg": "deg", "_m": "m", "_s": "s",
}  # fmt: skip
NAMED = {
    "k_eff_formula": "N m/rad", "k_eff_read": "N m/rad", "k_eff_stated": "N m/rad",
    "inertia_x": "kg m^2", "inertia_y": "kg m^2", "inertia_z": "kg m^2", "stiffness": "N m/rad",
    "kp": "N m/rad", "kv": "N m s/rad", "armature": "kg m^2", "damping": "N m s/rad",
    "friction": "N m", "force_limit": "N m", "delay": "s", "frequency": "Hz", "stroke": "rad",
    "launch": "m/s", "speed": "m/s",
}  # fmt: skip


def headed(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the unit of every number in its heading."""
    return {_heading(name): value for name, value in row.items()}


def _heading(name: str) -> str:
    if name in NAMED:
        return f"{name} [{NAMED[name]}]"
    end = next((end for end in ENDS if name.endswith(end)), None)
    return name if end is None else f"{name.removesuffix(end)} [{ENDS[end]}]"
