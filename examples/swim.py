"""A fish from numbers to a swim: describe it, compile its twin, beat its tail.

python examples/swim.py [--seconds 6]

my-fish: 6 bodies, 7 degrees of freedom
beat [Hz]  speed [m/s]
      1.0        0.057
      1.5        0.129
      2.0        0.157
      3.0        0.152
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import tailbeat as tb


def described(folder: Path) -> tb.Fish:
    """A fish from the commented template, with two of its numbers changed."""
    tb.new_fish(folder / "my-fish.toml")  # write your own fish's numbers into this file
    fish = tb.load_fish(folder / "my-fish.toml")
    return tb.with_values(fish, {"medium.viscosity": 0.9e-3, "zones.fin.kutta": 1.6})


def beat(frequency: float, seconds: float) -> tb.Recording:
    """Motor commands: a sine of 0.6 rad, a command every 20 ms."""
    time = np.arange(0, seconds, 0.02)
    angle = 0.6 * np.sin(2 * np.pi * frequency * time)
    return tb.Recording(f"{frequency:g} Hz", time, {"command_rad": angle})


def speed(fish: tb.Fish, command: tb.Recording) -> float:
    """Mean speed [m/s] over the second half of a swim from rest."""
    swum = tb.simulate(fish, command)
    half = swum.time.size // 2
    way = swum.qpos[-1, :2] - swum.qpos[half, :2]  # x and y of the fish [m]
    return float(np.linalg.norm(way) / (swum.time[-1] - swum.time[half]))


def main() -> None:
    """Swim at four frequencies."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each swim")
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        fish = described(Path(folder))
    twin = tb.compile_twin(fish)
    print(f"{fish.name}: {twin.model.nbody} bodies, {twin.model.nv} degrees of freedom")
    print("beat [Hz]  speed [m/s]")
    for frequency in (1.0, 1.5, 2.0, 3.0):
        print(f"{frequency:9.1f}  {speed(fish, beat(frequency, seconds)):11.3f}")


if __name__ == "__main__":
    main()
