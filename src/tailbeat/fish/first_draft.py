"""From a few measured numbers to a file: sketch, band that the servo can drive, step that holds."""

import tomllib
from dataclasses import replace
from pathlib import Path

from tailbeat.files import new_file
from tailbeat.fish import check, convergence
from tailbeat.fish.convergence import Deviation
from tailbeat.fish.description import Fish, Simulation
from tailbeat.fish.proportions import BAND, Given, Sketch, sketch
from tailbeat.fish.sketch_file import text_of
from tailbeat.fish.store import check_new_fish

LEAST_STROKE = 0.1  # rad at the shaft, in water, at the band's top; the pulley fish has 0.11
FIRST = Simulation(step=2e-3, integrator="Euler")


def new_fish(path: Path, given: Given) -> Deviation:
    """Write the sketch of a fish; returns the step that its convergence run chose. Raises BadInput
    for an impossible fish, or if `path` exists or does not end in .toml."""
    check_new_fish(path)
    drawn = sketch(given)
    drawn = replace(drawn, band=_band(drawn))
    chosen = convergence.choose(described(drawn))
    with new_file(path) as beside:
        text = text_of(path.stem, drawn, chosen.simulation, chosen.error)
        beside.write_text(text, encoding="utf-8")
    return chosen


def described(drawn: Sketch, simulation: Simulation = FIRST) -> Fish:
    """The fish that the file of a sketch describes."""
    return Fish.model_validate(tomllib.loads(text_of("sketch", drawn, simulation, 0.0)))


def _band(drawn: Sketch) -> tuple[float, float]:
    """The sketch's band, lowered to what the servo can drive in water."""
    fish = described(drawn)
    top = check.highest_beat(fish, check.tail_of(fish), LEAST_STROKE, drawn.band[1])
    return round(top * BAND[0] / BAND[1], 2), round(top, 2)
