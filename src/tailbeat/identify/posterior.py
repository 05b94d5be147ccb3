"""The posterior: draws of the identified numbers, kept beside the fish as `NAME-posterior.parquet`.

One row is one draw, one column per free number, in its unit; the first row is the fish itself. The
metadata say which fish it belongs to, what it was fitted to, by which versions, and how far the
twin is from held-out swims beyond the draws (`Discrepancy`).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars as pl
from numpy.typing import NDArray

from tailbeat.files import BadInput, new_file
from tailbeat.fish.description import COEFFICIENTS, Fish
from tailbeat.fish.store import digest, fish_path, load_fish, shipped
from tailbeat.identify.bands import Deviation, Discrepancy, Drawn, discrepancy
from tailbeat.identify.estimate import Estimate, as_row
from tailbeat.identify.fluid import with_row
from tailbeat.identify.quantities import UNITS
from tailbeat.identify.runs import Run
from tailbeat.identify.space import Parameter
from tailbeat.recording import read_parquet

Array = NDArray[np.float64]
SUFFIX = "-posterior.parquet"


@dataclass(frozen=True, eq=False)
class Posterior:
    """`draws` (n, p) of the numbers at the dotted `paths`, in `units`; the first is the fish.

    `fish` and `fish_digest` name the identified fish. `fitted` and `held_out` are the recordings'
    names. `discrepancy` is measured on `held_out`, None without any.
    """

    fish: str
    fish_digest: str
    paths: tuple[str, ...]
    units: tuple[str, ...]
    draws: Array
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    discrepancy: Discrepancy | None
    versions: str = ""


def drawn_for(
    fish: Fish,
    space: Sequence[Parameter],
    draws: Array,
    fitted: Sequence[Run],
    held_out: Sequence[Drawn],
) -> Posterior:
    """The posterior of an identified fish: `draws` (n, p) of the numbers in `space`, and the
    discrepancy on the swims `held_out` as the draws swim them."""
    return Posterior(
        fish.name,
        digest(fish),
        tuple(p.path for p in space),
        tuple(p.unit for p in space),
        draws,
        tuple(run.name for run in fitted),
        tuple(one.run.name for one in held_out),
        discrepancy(held_out) if held_out else None,
    )


def beside(fish: Path) -> Path:
    """Where the posterior of the fish file `fish` lies."""
    return fish.with_name(fish.stem + SUFFIX)


def of(fish: str, path: Path | None = None) -> Posterior | None:
    """The posterior at `path` (None: beside the fish, if there is one) of a shipped fish's name or
    file. Raises BadInput if it is another fish's or cannot be read."""
    chosen = path or beside(fish_path(fish))
    if path is None and not chosen.is_file():
        return None
    known = read(chosen)
    check_own(load_fish(fish), known)
    return known


def at_hand(fish: str, trained: Fish) -> Posterior | None:
    """The posterior beside a fish, if that is the one which a policy was `trained` on. None without
    one, for a policy's fish of which no file is at hand, or for a newer one of its name. Raises
    BadInput as `of`."""
    if fish not in shipped() and not Path(fish).is_file():
        return None
    found = load_fish(fish).model_copy(update={"servo": trained.servo})
    return of(fish) if digest(found) == digest(trained) else None


def needed(fish: str) -> Posterior:
    """The posterior beside a fish. Raises BadInput as `of`, and if there is none."""
    known = of(fish)
    if known is None:
        raise BadInput(
            f"{fish}: no posterior beside the fish; write it with `tailbeat identify posterior`."
        )
    return known


def fishes(fish: Fish, posterior: Posterior, most: int | None = None) -> list[Fish]:
    """The fish with each draw's numbers, the first `most` draws (None: all). Raises BadInput if the
    posterior is another fish's."""
    check_own(fish, posterior)
    return [with_row(fish, posterior.paths, row) for row in posterior.draws[:most]]


def factors_of(fish: str) -> Array:
    """`coefficient_factors` of a shipped fish's name or a file with its posterior beside it. Raises
    BadInput without one."""
    return coefficient_factors(load_fish(fish), needed(fish))


def coefficient_factors(fish: Fish, posterior: Posterior) -> Array:
    """The draws' coefficients over the fish's own (n, zones, 5), in the order of `fish.zones` and
    `COEFFICIENTS`; numbers of the trailing edge are left out. Raises BadInput as `check_own`."""
    check_own(fish, posterior)
    drawn = np.ones((len(posterior.draws), len(fish.zones), len(COEFFICIENTS)))
    for path, column in zip(posterior.paths, posterior.draws.T, strict=True):
        kind, _, rest = path.partition(".")
        zone, _, name = rest.partition(".")
        if kind == "zones":
            own = [i for i, one in enumerate(fish.zones) if zone in ("*", one)]
            drawn[:, own, COEFFICIENTS.index(name)] = (column / column[0])[:, None]
    return drawn


def estimates(posterior: Posterior) -> dict[str, Estimate]:
    """Field -> the fish's value with the 95 % interval of the draws."""
    spans = np.quantile(posterior.draws, [0.025, 0.975], axis=0).T.tolist()
    rows = zip(posterior.paths, posterior.draws[0].tolist(), spans, posterior.units, strict=True)
    return {path: Estimate(value, (low, high), unit) for path, value, (low, high), unit in rows}


def as_rows(posterior: Posterior) -> dict[str, Any]:
    """The JSON of `estimates`, by field."""
    return {path: as_row(one) for path, one in estimates(posterior).items()}


def check_own(fish: Fish, posterior: Posterior) -> None:
    """Raises BadInput if the posterior was not drawn for exactly this fish."""
    if posterior.fish_digest != digest(fish):
        raise BadInput(
            f"the posterior is of {posterior.fish} ({posterior.fish_digest}), not of {fish.name}"
            f" ({digest(fish)}); give the fish that was identified with it, or identify it again."
        )


def write(path: Path, posterior: Posterior) -> None:
    """Write a posterior. Raises BadInput if `path` exists."""
    frame = pl.DataFrame(dict(zip(posterior.paths, posterior.draws.T, strict=True)))
    with new_file(path) as to:
        frame.write_parquet(to, metadata={"tailbeat_posterior": json.dumps(_facts(posterior))})


def _facts(posterior: Posterior) -> dict[str, Any]:
    known = posterior.discrepancy
    return {
        "fish": posterior.fish,
        "fish_digest": posterior.fish_digest,
        "units": posterior.units,
        "fitted": posterior.fitted,
        "held_out": posterior.held_out,
        "discrepancy": None if known is None else asdict(known),
        "versions": f"mujoco {mujoco.__version__}, tailbeat {version('tailbeat')}",
    }


def read(path: Path) -> Posterior:
    """Read a posterior. Raises BadInput for a file that is none, or that has a number that is not
    finite."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; `tailbeat identify fluid` writes it.")
    frame, stated = read_parquet(path)
    try:
        found = _from(frame, json.loads(stated["tailbeat_posterior"]))
    except (pl.exceptions.PolarsError, KeyError, TypeError, ValueError):
        raise BadInput(
            f"{path}: not a posterior of `tailbeat identify`; identify the fish again."
        ) from None
    bad = [name for name, column in zip(found.paths, found.draws.T, strict=True) if _wrong(column)]
    if bad or not len(found.draws):
        where = f"column {bad[0]} has a value that is not finite" if bad else "it has no draw"
        raise BadInput(f"{path}: {where}; identify the fish again.")
    return found


def _wrong(column: Array) -> bool:
    return not bool(np.isfinite(column).all())


def _discrepancy(known: Mapping[str, Any] | None) -> Discrepancy | None:
    """What is kept of a discrepancy; None for the numbers of releases up to 0.2.0 and of versions
    between, whose bands were other ones."""
    if known is None or "usual" not in known:
        return None
    own = {name: Deviation(**known[name]) for name in UNITS}
    return Discrepancy(**own, swims=known["swims"], usual=known["usual"])


def _from(frame: pl.DataFrame, facts: Mapping[str, Any]) -> Posterior:
    units: Sequence[str] = facts["units"]
    if len(units) != frame.width:
        raise ValueError
    return Posterior(
        facts["fish"],
        facts["fish_digest"],
        tuple(frame.columns),
        tuple(units),
        frame.to_numpy().astype(np.float64),
        tuple(facts["fitted"]),
        tuple(facts["held_out"]),
        _discrepancy(facts["discrepancy"]),
        facts["versions"],
    )
