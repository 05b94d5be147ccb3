"""Compare recorded swims with a fish: what its twin predicts, and what its recordings cover."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tailbeat.evaluate.runs import as_recordings
from tailbeat.evaluate.store import read_chunk
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify import coverage as cover
from tailbeat.identify import kinematic, predict
from tailbeat.identify.runs import as_run
from tailbeat.recording import Recording, read_recording


def predict_swims(
    fish: str, swims: Sequence[Path], fitted_on: Sequence[Path] = ()
) -> dict[str, Any]:
    """Measured and predicted figures of recordings, logs or an evaluation's chunks; with
    `fitted_on`, those of the naive model fitted on these recordings too."""
    described = load_fish(fish)
    runs = [as_run(recording, described) for path in swims for recording in read_swims(path)]
    result = predict.as_json(predict.predict(described, runs))
    if fitted_on:
        known = [as_run(read_recording(path), described) for path in fitted_on]
        result |= kinematic.beside(result, runs, known)
    return result


def coverage(fish: str, swims: Sequence[Path], against: Sequence[Path]) -> dict[str, Any]:
    """Compare swims, logs or an evaluation's chunks, with the recordings of an identification."""
    described = load_fish(fish)
    played = [recording for path in swims for recording in read_swims(path)]
    found = cover.coverage(played, [read_recording(path) for path in against], described)
    return cover.as_json(found)


def read_swims(path: Path) -> list[Recording]:
    """The swims of a file. Raises BadInput where an evaluation's chunk holds none long enough."""
    if path.suffix != ".npz":
        return [read_recording(path)]
    found = as_recordings(read_chunk(path), path.stem)
    if not found:
        raise BadInput(f"{path}: no swim of 1 s or more; give another chunk.")
    return found
