"""Compare recorded swims with a fish: what its twin predicts, and what its recordings cover."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tailbeat.evaluate.runs import as_recordings
from tailbeat.evaluate.store import read_chunk
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.identify import coverage as cover
from tailbeat.identify import kinematic
from tailbeat.identify import posterior as store
from tailbeat.identify.bands import Band, Discrepancy, bands, discrepancy, swim_all
from tailbeat.identify.bands import as_json as bands_json
from tailbeat.identify.coverage import Coverage
from tailbeat.identify.predict import Prediction, predict
from tailbeat.identify.predict import as_json as predictions_json
from tailbeat.identify.runs import Run, as_runs
from tailbeat.recording import Recording, read_recording, refuse_shared

DRAWS = 32  # of a posterior, for bands


@dataclass(frozen=True, eq=False)
class Replay:
    """A twin's predictions of swims, the naive model's if requested, and the 95 % bands of all
    swims if the fish has a posterior with a `discrepancy`, or check swims gave one."""

    predictions: tuple[Prediction, ...]
    rival: kinematic.Rival | None = None
    discrepancy: Discrepancy | None = None
    bands: tuple[Band, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether no run diverged and every run reached a steady speed."""
        return all(one.settled for one in self.predictions)


def predict_swims(
    fish: str,
    swims: Sequence[Path],
    fitted_on: Sequence[Path] = (),
    posterior: Path | None = None,
    check: Sequence[Path] = (),
) -> Replay:
    """Compare measured and predicted numbers of recordings, logs or an evaluation's chunks. With
    `fitted_on`, also those of the naive model fitted to these recordings. `posterior` is a file
    (None: the one beside the fish, if there is one); `check` are swims in the same water, which
    give the discrepancy instead. Raises BadInput."""
    described = load_fish(fish)
    refuse_shared({"SWIMS": swims, "--fitted-on": fitted_on, "--check": check})
    known = store.of(fish, posterior)
    if check and known is None:
        known = store.needed(fish)
    runs, fitted, checked = (_runs(described, paths) for paths in (swims, fitted_on, check))
    found = tuple(predict(described, runs))
    rival = kinematic.beside(found, fitted) if fitted else None
    if known is None:
        return Replay(found, rival)
    drawn = store.fishes(described, known, DRAWS)
    apart = discrepancy(swim_all(drawn, checked)) if checked else known.discrepancy
    swum = swim_all(drawn, runs) if apart else []
    return Replay(found, rival, apart, tuple(band for one in swum for band in bands(one, apart)))


def _runs(fish: Fish, paths: Sequence[Path]) -> list[Run]:
    return [run for path in paths for one in read_swims(path) for run in as_runs(one, fish)]


def as_json(replay: Replay) -> dict[str, Any]:
    """The result of `tailbeat predict`."""
    rival = {} if replay.rival is None else kinematic.as_json(replay.rival)
    known = bands_json(replay.bands) if replay.bands else {}
    apart = asdict(replay.discrepancy) if replay.discrepancy else None
    return {**predictions_json(replay.predictions), **rival, **known, "discrepancy": apart}


def coverage(fish: str, swims: Sequence[Path], against: Sequence[Path]) -> Coverage:
    """Compare swims, logs or an evaluation's chunks, with the recordings of an identification."""
    described = load_fish(fish)
    played = [recording for path in swims for recording in read_swims(path)]
    return cover.coverage(played, [read_recording(path) for path in against], described)


def read_swims(path: Path) -> list[Recording]:
    """Read the swims of a file. Raises BadInput if an evaluation's chunk has none of 1 s or
    more."""
    if path.suffix != ".npz":
        return [read_recording(path)]
    found = as_recordings(read_chunk(path), path.stem)
    if not found:
        raise BadInput(f"{path}: no swim of 1 s or more; give another chunk.")
    return found
