"""A zoo of eight fish of all sizes, drawn from a seed: the fish in a pool, and what its user
believes of it, which is wrong by 40 % in stiffness and servo."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tailbeat.control.measure import MASS
from tailbeat.fish.catalogue import profiles
from tailbeat.fish.proportions import BEND_SHARE, K_EFF, LENGTH, STROKE, Given
from tailbeat.fish.store import Entry, load_fish, write_identified

COUNT = 8  # fish; the last one is the shipped crank fish
SHORTEST, LONGEST = 0.15, 1.2  # m
LIGHTEST, HEAVIEST = 0.1, 20.0  # kg
SERVOS = ("xl330", "xl430", "xw430", "xm430", "xm540")  # from the weakest to the strongest
WRONG = 0.4  # share by which the user's first numbers err, up or down
SERVO = ("kp", "armature", "damping", "force_limit", "delay")
UNITS = {"kp": "N m/rad", "armature": "kg m^2", "damping": "N m s/rad", "force_limit": "N m",
         "delay": "s"}  # fmt: skip


@dataclass(frozen=True)
class Animal:
    """A fish of the zoo: what `new-fish` is given (None: the crank fish, which is shipped)."""

    name: str
    given: Given | None


def animals(seed: int = 0) -> tuple[Animal, ...]:
    """The fish of a seed: one in each seventh of the lengths, on a logarithmic scale, with masses,
    hinges, servos and stiffnesses drawn about what suits the length; and the crank fish."""
    rng = np.random.default_rng([seed, 23])
    share = (np.arange(COUNT - 1) + rng.uniform(size=COUNT - 1)) / (COUNT - 1)
    lengths = SHORTEST * (LONGEST / SHORTEST) ** share
    hinges = rng.permutation([2, 3, 4, 5, 6, 7, 8])
    found = [_drawn(float(a), int(b), rng) for a, b in zip(lengths, hinges, strict=True)]
    named = [Animal(f"{i}-{_label(one)}", one) for i, one in enumerate(found)]
    return (*named, Animal(f"{COUNT - 1}-crank", None))


def _label(given: Given) -> str:
    return f"{1e3 * given.length:.0f}mm"


def _drawn(length: float, hinges: int, rng: np.random.Generator) -> Given:
    """A fish of a length [m]: its mass within 40 % of the paper's fish's, grown with the length; a
    servo that bends its tail; a tail from half to one and a half times as stiff as usual."""
    scale = length / LENGTH
    mass = np.clip(MASS * scale**3 * np.exp(rng.uniform(-0.35, 0.35)), LIGHTEST, HEAVIEST)
    needed = K_EFF * scale**3 * STROKE / BEND_SHARE
    strong = [name for name in SERVOS if profiles()[name].stall_nm >= needed] or [SERVOS[-1]]
    servo = strong[0]
    usual = min(K_EFF * scale**3, BEND_SHARE * profiles()[servo].stall_nm / STROKE)
    stiff = usual * np.exp(rng.uniform(np.log(0.5), np.log(1.5)))
    return Given(round(length, 3), float(f"{mass:.3g}"), hinges, servo, k_eff=float(f"{stiff:.3g}"))


def guess(lab: Path, target: Path, seed: int) -> None:
    """Write what the user believes: the fish with stiffness and servo `WRONG`, up or down."""
    rng, fish = np.random.default_rng([seed, 24]), load_fish(lab)
    servo, stem = fish.servos[fish.servo], f"servos.{fish.servo}."
    stiff = _factor(rng)
    values = {
        f"tail.links.{i}.stiffness": (stiff * one.stiffness, "N m/rad")
        for i, one in enumerate(fish.tail.links)
    }
    if fish.tail.k_eff is not None:
        values["tail.k_eff"] = stiff * fish.tail.k_eff, "N m/rad"
    values |= {stem + name: (_factor(rng) * getattr(servo, name), UNITS[name]) for name in SERVO}
    entries: dict[str, Entry | str] = {
        path: {"value": float(f"{value:.6g}"), "unit": unit, "source": "a first guess"}
        for path, (value, unit) in values.items()
    }
    write_identified(lab, target, entries | {"name": target.stem}, "A user's first guess.", True)


def _factor(rng: np.random.Generator) -> float:
    return float(rng.choice([1 - WRONG, 1 + WRONG]))
