"""Make the sample recordings of this folder again: `python examples/bench/make.py`."""

import sys
from pathlib import Path

from tailbeat.fish.store import load_fish
from tailbeat.identify.protocol import limits, servo_commands
from tailbeat.recording import Recording, write_recording

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from synthetic_recordings import (  # noqa: E402  (lies beside the tests)
    Noise,
    TailTruth,
    release,
    servo_run,
    slow_pull,
    tail_sweep,
)


def write(name: str, recording: Recording) -> None:
    """Write one sample, rounded to what its sensors resolve."""
    write_recording(recording, HERE / f"{name}.csv", overwrite=True)


def main() -> None:
    """Twelve tail conditions, a slow pull, a release, and five servo runs."""
    truth, noise = TailTruth(), Noise(rate=60.0)
    sweep = tail_sweep(truth, (0.7, 1.3, 2.2, 3.6), (0.1, 0.2, 0.3), 5.0, 1, noise)
    write("tail-sweep", sweep)
    write("tail-static", slow_pull(truth, 0.3, 30.0, 2))
    write("tail-release", release(truth, 0.3, 3.0, 3))
    fish = load_fish("pulley-fish")
    for seed, (name, command) in enumerate(servo_commands(fish, limits(fish)).items()):
        write(name, servo_run(fish, command, seed))


if __name__ == "__main__":
    main()
