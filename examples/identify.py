"""Identify the test bench: the tail's stiffness and damping, then the servo.

python examples/identify.py [--generations 20]

tail            value  95 % interval      made with
k [N m/rad]    0.9834   0.9781  0.9886  0.98
servo-mixed (validate): 0.03 deg rms
"""

import argparse
import tempfile
from pathlib import Path

import tailbeat as tb
from tailbeat.identify.search import Effort
from tailbeat.identify.servo_job import ServoConfig

BENCH = Path(__file__).parent / "bench"


def tail() -> None:
    """Twelve driven conditions give four numbers at the shaft."""
    found = tb.identify_tail([tb.read_recording(BENCH / "tail-sweep.csv")])
    print("tail            value  95 % interval      made with")
    rows = [("k [N m/rad]", found.k_eff, 0.98), ("I [kg m2]", found.i_eff, 0.0011)]
    rows += [("c [N m s/rad]", found.c_eff, 0.011), ("F [N m]", found.coulomb, 0.02)]
    for name, number, truth in rows:
        low, high = number.interval
        print(f"{name:13s} {number.value:7.4f}  {low:7.4f} {high:7.4f}  {truth:g}")


def servo(generations: int) -> None:
    """Commands and encoder angles give the servo's parameters; one recording is held out."""
    fish = tb.load_fish("pulley-fish")
    fitted, held_out = (
        [tb.as_bench(tb.read_recording(BENCH / f"servo-{name}.csv"), fish) for name in names]
        for names in (("beat", "chirp", "steps"), ("mixed",))
    )
    effort = Effort(generations=generations, population=32, polish=20, scouts=500)
    config = ServoConfig(seeds=1, effort=effort)
    with tempfile.TemporaryDirectory() as scratch:  # an interrupted search goes on from here
        found = tb.identify_servo(fish, fitted, held_out, config, Path(scratch))
    print("servo:", ", ".join(f"{name} {value:.3g}" for name, value in found.servo.items()))
    for overlay in found.overlays:
        error = (overlay.error_deg() ** 2).mean() ** 0.5
        print(f"{overlay.bench.name} ({overlay.role}): {error:.2f} deg rms")


def main() -> None:
    """Read the sample recordings of examples/bench, which were made with known numbers."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--generations", type=int, default=20, help="of the servo's search")
    generations = parser.parse_args().generations
    tail()
    servo(generations)


if __name__ == "__main__":
    main()
