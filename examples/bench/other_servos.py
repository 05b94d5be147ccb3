"""Pendulum recordings of servos of other makes: `python examples/bench/other_servos.py OUT`.

One folder for each make. The names say the load: `light` or `heavy`. What is simulated, and from
whose numbers, stands in `tests/other_servos.py`.
"""

import json
import sys
from itertools import count, product
from pathlib import Path

from tailbeat.importers.xl330 import convert

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from other_servos import MOTIONS, SERVOS, pendulum_log


def main(out: Path) -> None:
    """Every motion at every gain with both loads, imported as a user would."""
    seed = count()
    for make, servo in SERVOS.items():
        (out / make).mkdir(parents=True)
        for gain, motion, load in product(servo.gains, MOTIONS, servo.loads):
            name = f"{motion}-{gain}-{'light' if load == min(servo.loads) else 'heavy'}"
            log = out / make / f"{name}.json"
            log.write_text(json.dumps(pendulum_log(make, motion, gain, load, next(seed))))
            convert(log, log.with_suffix(".csv"), "simulated")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
