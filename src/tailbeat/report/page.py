"""One page of a folder's results: numbers compared with the paper's, every figure, provenance.

Computes nothing except what `evaluation.read` and `comparison.read` return.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tailbeat.control.measure import Measure, centimetres
from tailbeat.evaluate import comparison, evaluation, spectrum, store, track
from tailbeat.evaluate.comparison import Comparison
from tailbeat.evaluate.evaluation import Evaluation
from tailbeat.evaluate.fresh_recordings import FreshResult
from tailbeat.evaluate.rates import ConditionResult, Difference
from tailbeat.evaluate.reach import TRAINED, ReachResult
from tailbeat.evaluate.trial import CHUNK
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.report import figures, fresh_recordings, swim_figures
from tailbeat.report.html import Block, Section, figure, picture, table, values, write
from tailbeat.report.paper import arrived, beside_paper, near
from tailbeat.report.tables import as_rows

Result = Evaluation | Comparison


def report(out: Path, fish: Fish, twin: Fish, data: Result | None = None) -> tuple[Path, Result]:
    """Write the page of an evaluation or a comparison, from `data` or read from the folder. Raises
    BadInput for a folder without either."""
    if data is None:
        data = _read(out)
    if isinstance(data, Evaluation):
        sections, title = evaluated(out, data, fish, twin), "Zero-shot in the virtual pool"
    else:
        sections, title = compared(out, data), "Which action space transfers"
    return write(out, sections, data, title), data


def _read(out: Path) -> Result:
    if store.has_runs(out):
        return evaluation.read(out)
    if comparison.has_cells(out):
        return comparison.read(out)
    raise BadInput(f"{out}: contains neither an evaluation nor a comparison; make one first.")


def of_folder(
    out: Path, fish: str, twin: str | None = None, data: Result | None = None
) -> tuple[Path, Result]:
    """Write the page of a folder, with fish by name; `data` are its numbers, if known. Raises
    BadInput."""
    if not out.is_dir() or not any(out.iterdir()):
        raise BadInput(f"{out}: folder is empty or missing; run `tailbeat evaluate` into it first.")
    described = load_fish(fish)
    if store.has_runs(out):
        swum = store.read_description(out)
        if swum.fish_digest != digest(described):
            raise BadInput(f"{out}: {swum.fish} swam there, not {fish}; give its file with --fish.")
    return report(out, described, trained_on(out, fish, twin), data)


def trained_on(out: Path, fish: str, twin: str | None) -> Fish:
    """The fish that a folder's policy was trained on."""
    if twin is not None or not store.has_runs(out):
        return load_fish(twin or fish)
    return store.kept_fish(out) or load_fish(store.read_description(out).twin)


# ---- an evaluation ------------------------------------------------------------------------------


def evaluated(out: Path, data: Evaluation, fish: Fish, twin: Fish) -> list[Section]:
    """Sections of an evaluation, figures drawn into `figures/`."""
    sections = [Section("Compared with the paper", (*_warnings(data), table(beside_paper(data))))]
    sections += _reach(out, data, fish)
    sections += _costs(out, data.disturb, "Disturbed", "disturb")
    sections += _costs(out, data.out_of_distribution, "Out of distribution", "out-of-distribution")
    sections += _costs(out, data.messy, "Messy labs", "messy")
    if data.track:
        swims, _ = store.load(out, track.TRACK, 1)
        drawn = swim_figures.following(track.by_path(swims), data.track)
        blocks = (table(as_rows(data.track)), figure(drawn, out, "following"))
        sections.append(Section("Following", blocks))
    if data.spectrum:
        low, high = data.run.band
        drawn = swim_figures.power(data.spectrum, spectrum.BINS, data.run.band)
        blocks = (table(_powers(data)), figure(drawn, out, "power"))
        sections.append(Section(f"Velocity power, band {low:g} to {high:g} Hz", blocks))
    if data.twin is not None:
        sections.append(_fresh(out, data.twin, twin))
    return [*sections, Section("Provenance", (_provenance(data),))]


def _warnings(data: Evaluation) -> list[Block]:
    cut = ", ".join(data.cut_short)
    return [Block("warning", f"Incomplete, read as far as they go: {cut}.")] if cut else []


def _costs(out: Path, rows: tuple[ConditionResult, ...], heading: str, name: str) -> list[Section]:
    if not rows:
        return []
    drawn = swim_figures.costs(rows, heading)
    return [Section(heading, (table(_plain(rows)), figure(drawn, out, name)))]


def _powers(data: Evaluation) -> list[dict[str, Any]]:
    names = ("runs", "gait", "pieces", "share_below", "share_below_floor", "share_inside")
    return [{name: getattr(row, name) for name in (*names, "share_above")} for row in data.spectrum]


def _fresh(out: Path, found: FreshResult, twin: Fish) -> Section:
    blocks = [table(as_rows(rows)) for rows in (found.tail, found.servo, found.swims)]
    blocks += [picture(path) for path in fresh_recordings.draw(out / "twin", twin)]
    if found.speeds is not None:
        for end in (".svg", ".png"):
            figures.speed_map(found.speeds, out / "figures" / f"speeds{end}", overwrite=True)
        blocks.append(picture(out / "figures" / "speeds.svg"))
    return Section("The twin on new recordings", tuple(blocks))


def _reach(out: Path, data: Evaluation, fish: Fish) -> list[Section]:
    if not data.reach:
        return []
    blocks = [figure(swim_figures.sectors(data.reach), out, "reach-sectors")]
    for name, row in data.reach.items():
        swims, _ = store.load(out, name, -(-data.run.conditions[name] // CHUNK))
        stem = name.replace(" ", "-")
        blocks += [Block("heading", name), table([_reach_row(row, data.run.measure)])]
        blocks.append(figure(swim_figures.heat_map(row.cells, name), out, f"{stem}-rates"))
        blocks.append(figure(swim_figures.reach_map(swims, name), out, f"{stem}-map"))
        if not name.endswith("twin"):
            blocks.append(figure(swim_figures.paths(swims, fish), out, f"{stem}-paths"))
            blocks.append(figure(swim_figures.gaits(swims), out, f"{stem}-gaits"))
    return [Section("Reaching", tuple(blocks))]


def _reach_row(row: ReachResult, m: Measure) -> dict[str, Any]:
    trained, span = row.trained_range, f"±120°, to {TRAINED * m.reach:.3g} m"
    close, wide = centimetres(m.arrival), centimetres(m.near)
    return {
        "swims": row.swims,
        f"{close} [%]": arrived(row),
        f"{wide} [%]": near(row),
        f"{span}: {close} [%]": arrived(trained),
        f"{span}: {wide} [%]": near(trained),
        "median time [s]": row.median_seconds,
        "path length over distance": row.median_path_ratio,
        "lost": row.lost,
    }


def _provenance(data: Evaluation) -> Block:
    run = {k: v for k, v in vars(data.run).items() if k not in ("conditions", "training")}
    training = {f"training {k}": v for k, v in data.run.training.items()}
    return values({**vars(data.provenance), **run, **training})


# ---- a comparison -------------------------------------------------------------------------------


def compared(out: Path, data: Comparison) -> list[Section]:
    """Sections of a comparison."""
    drawn = figure(swim_figures.transfer(data.kinds), out, "transfer")
    return [
        Section("Gap between twin and pool", (drawn, table(_plain(data.kinds)))),
        Section("Every policy in every water", (table(_plain(data.rows)),)),
        Section("Provenance", (values(vars(data.provenance)),)),
    ]


def _plain(records: Iterable[Any]) -> list[dict[str, Any]]:
    """Records as rows; a difference with its interval is one cell."""
    return [
        {name: _gap(one) if isinstance(one, Difference) else one for name, one in row.items()}
        for row in as_rows(records)
    ]


def _gap(value: Difference) -> str:
    low, high = value.interval
    return f"{100 * value.difference:+.1f} ({100 * low:+.1f} … {100 * high:+.1f})"
