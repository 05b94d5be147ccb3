"""Read quantities of a description: a number in SI, text with a unit, or a table with a source."""

import math
import re
from functools import partial
from typing import Annotated, Any

from pydantic import BeforeValidator

# Factor from each accepted unit to SI, by dimension. The first unit of a row is the SI one.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "mass": {"kg": 1.0, "g": 1e-3},
    "inertia": {"kg m^2": 1.0, "g m^2": 1e-3, "g cm^2": 1e-7},
    "angle": {"rad": 1.0, "deg": 0.017453292519943295},
    "time": {"s": 1.0, "ms": 1e-3},
    "frequency": {"Hz": 1.0},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "viscosity": {"Pa s": 1.0, "mPa s": 1e-3},
    "torque": {"N m": 1.0, "N mm": 1e-3},
    "angular stiffness": {"N m/rad": 1.0, "N mm/rad": 1e-3, "N m/deg": 57.29577951308232},
    "angular damping": {"N m s/rad": 1.0, "N mm s/rad": 1e-3},
    "linear stiffness": {"N/m": 1.0, "kN/m": 1e3, "N/mm": 1e3},
    "linear damping": {"N s/m": 1.0},
    "voltage": {"V": 1.0},
    "current": {"A": 1.0, "mA": 1e-3},
    "temperature": {"degC": 1.0},
    "ratio": {"1": 1.0},
    "fraction": {"1": 1.0, "%": 1e-2},
    "force": {"N": 1.0, "mN": 1e-3},
    "tether drag": {"N s^2/m^2": 1.0},
    "angular rate": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
}


LARGEST = 1e10  # in SI, of any number of a fish: beyond, squares of products overflow


def typed(text: str, dimension: str) -> float:
    """A quantity as typed on a command line, in SI: "280mm", "280 mm", or "0.28" for the SI unit.
    Raises ValueError that says what is allowed."""
    usual = next(iter(UNITS[dimension]))
    found = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([a-zA-Z].*)?", text)
    number = None if found is None else _number(found[1])
    if found is None or number is None or not math.isfinite(number):
        raise ValueError(f"{text!r} is not a number with a unit such as {usual}")
    unit = (found[2] or usual).strip()
    return number * _factor(unit, dimension)


def _to_si(raw: Any, dimension: str) -> Any:
    """Return `raw` in SI: a number, text such as "19.5 mm", or a table of value, unit, source."""
    if isinstance(raw, list):
        return [_to_si(item, dimension) for item in raw]
    if isinstance(raw, str):
        return _from_text(raw, dimension)
    if isinstance(raw, dict):
        return _from_table(raw, dimension)
    return _scaled(raw, 1.0)


def _from_text(text: str, dimension: str) -> Any:
    """Numbers, then one unit: "0.98 N m/rad", "154 5 100 mm"."""
    words = text.split()
    numbers = []
    while words and (number := _number(words[0])) is not None:
        numbers.append(number)
        words.pop(0)
    if not numbers:
        raise ValueError('write a number and a unit, such as "19.5 mm"')
    scaled = _scaled(numbers, _factor(" ".join(words), dimension))
    return scaled if len(scaled) > 1 else scaled[0]


def _from_table(table: dict[str, Any], dimension: str) -> Any:
    unknown = set(table) - {"value", "unit", "source", "interval"}
    if unknown or not {"value", "unit"} <= set(table):
        raise ValueError("a quantity is a table of value, unit and source")
    return _scaled(table["value"], _factor(table["unit"], dimension))


def _factor(unit: str, dimension: str) -> float:
    allowed = UNITS[dimension]
    if unit not in allowed:
        raise ValueError(f"unit {unit!r} is not one of {', '.join(allowed)} ({dimension})")
    return allowed[unit]


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _scaled(value: Any, factor: float) -> Any:
    """Multiply numbers in nested lists by `factor`; pydantic refuses everything else later."""
    if isinstance(value, list):
        return [_scaled(item, factor) for item in value]
    if isinstance(value, bool):
        raise ValueError(
            'true and false are no quantities; write a number and a unit, as "19.5 mm"'
        )
    if not isinstance(value, int | float):
        return value
    if abs(value * factor) > LARGEST:
        raise ValueError(f"{value:g} is beyond {LARGEST:g} in SI; check its unit")
    return value * factor


def _quantity(dimension: str) -> BeforeValidator:
    # `partial`, not a lambda: the reference of the site reads the dimension from it.
    return BeforeValidator(partial(_to_si, dimension=dimension))


Pair = tuple[float, float]
Triple = tuple[float, float, float]

Length = Annotated[float, _quantity("length")]
Points2 = Annotated[tuple[Pair, ...], _quantity("length")]
Point3 = Annotated[Triple, _quantity("length")]
Mass = Annotated[float, _quantity("mass")]
Inertia = Annotated[float, _quantity("inertia")]
Inertia3 = Annotated[Triple, _quantity("inertia")]
Angle = Annotated[float, _quantity("angle")]
AngleRange = Annotated[Pair, _quantity("angle")]
Angles3 = Annotated[Triple, _quantity("angle")]
Time = Annotated[float, _quantity("time")]
Speed = Annotated[float, _quantity("speed")]
FrequencyRange = Annotated[Pair, _quantity("frequency")]
Density = Annotated[float, _quantity("density")]
Viscosity = Annotated[float, _quantity("viscosity")]
Torque = Annotated[float, _quantity("torque")]
AngularStiffness = Annotated[float, _quantity("angular stiffness")]
AngularDamping = Annotated[float, _quantity("angular damping")]
LinearStiffness = Annotated[float, _quantity("linear stiffness")]
LinearDamping = Annotated[float, _quantity("linear damping")]
Voltage = Annotated[float, _quantity("voltage")]
VoltageRange = Annotated[Pair, _quantity("voltage")]
Current = Annotated[float, _quantity("current")]
Temperature = Annotated[float, _quantity("temperature")]
Ratio = Annotated[float, _quantity("ratio")]
Fraction = Annotated[float, _quantity("fraction")]
Force = Annotated[float, _quantity("force")]
TetherDrag = Annotated[float, _quantity("tether drag")]
AngularRate = Annotated[float, _quantity("angular rate")]
