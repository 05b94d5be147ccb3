"""Picture, film and page of a tour of targets. Draws what was swum; computes nothing."""

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from tailbeat.control.actions import PERIOD
from tailbeat.evaluate.motion import Span, of_log, of_tour
from tailbeat.evaluate.provenance import Provenance, provenance
from tailbeat.evaluate.swim import Counting, Swum
from tailbeat.evaluate.tour import Tour
from tailbeat.evaluate.trial import Pool, Progress
from tailbeat.files import BadInput, write_json
from tailbeat.fish.outline import outline
from tailbeat.operator.tour import TargetResult
from tailbeat.pool.mess import named
from tailbeat.pool.water import fingerprint
from tailbeat.report import film, html
from tailbeat.report.film_frames import Shot
from tailbeat.report.html import Block, Section
from tailbeat.report.pool_scene import View
from tailbeat.report.style import MISSED, POOL, REACHED, WAY, draw_walls, styled

FILM_SECONDS = 16.0  # duration of a tour's film, from the tour's start


@dataclass(frozen=True)
class TourReport:
    """Summary of a tour.

    Its configuration, with the level or file of its lab's `mess`; the fish and the pool's water;
    the result of each target; how many the fish `arrived` at (within `arrival_m`, 5 cm for the
    paper's fish) and how many it came `near` (within four times that); the time of the whole tour
    and the median time of the targets reached [s]; the provenance of policy and numbers.
    """

    policy: str
    seed: int
    mess: str
    log: str | None
    armed_anew: int | None
    fish: str
    water: str
    targets: tuple[TargetResult, ...]
    arrived: int
    near: int
    arrival_m: float
    seconds: float
    median_seconds: float | None
    training: Mapping[str, object]
    provenance: Provenance


def write(
    swum: Swum, out: Path, counting: Counting, film_seconds: float = FILM_SECONDS
) -> TourReport:
    """Write summary, film, picture and page of a swim; the summary first, because a film takes
    long. If no film can be rendered, the page says why."""
    own, data = swum.pool.fish, summary(swum)
    write_json(out / "summary.json", data, overwrite=True)
    with counting() as progress:
        shown = _film(swum, out / "swim.mp4", film_seconds, progress)
    drawn = html.figure(picture(swum.tour, swum.pool), out, "swim")
    blocks = (shown, drawn, html.table(rows(data.targets)))
    where = {"mess": data.mess, "seed": data.seed}
    origin = html.values({**where, **vars(data.provenance), **data.training})
    sections = [Section("The swim", blocks), Section("Provenance", (origin,))]
    if data.log is not None:
        sections.insert(1, Section("Correct the policy by this swim", (_refine(data),)))
    html.write(out, sections, data, f"{own.name} in the virtual pool")
    return data


def _refine(data: TourReport) -> Block:
    """The command that corrects the policy by the swim's log."""
    words = ("tailbeat", "refine", data.policy, "--log", str(data.log), "--out", "refined")
    return Block("command", shlex.join(words))


def _film(swum: Swum, path: Path, seconds: float, progress: Progress) -> Block:
    """The film of the tour's first seconds, or a warning why there is none."""
    path.unlink(missing_ok=True)  # the film of an earlier tour
    rate, span, fish = film.rate_of(path), Span(seconds), swum.pool.fish
    try:
        if swum.log is None:
            motion = of_tour(swum.tour, span, rate, swum.pool.measure.arrival)
        else:
            motion = of_log(swum.log, fish, span, rate)
        film.write(Shot(fish, motion, view=View(pool=swum.pool.walls)), path, progress)
    except BadInput as error:
        return Block("warning", f"There is no film: {error}")
    return html.film(path)


def summary(swum: Swum) -> TourReport:
    """Summarise a swim."""
    tour, hits, m = swum.tour, swum.tour.reached, swum.pool.measure
    return TourReport(
        policy=swum.asked.policy,
        seed=swum.asked.seed,
        mess=named(swum.asked.mess),
        log=None if swum.log is None else str(swum.log),
        armed_anew=swum.armed_anew,
        fish=swum.pool.fish.name,
        water=fingerprint(swum.pool.waters),
        targets=tour.results(),
        arrived=int(hits.sum()),
        near=int((tour.nearest < m.near).sum()),
        arrival_m=m.arrival,
        seconds=PERIOD * len(tour.goal),
        median_seconds=float(np.median(tour.seconds[hits])) if hits.any() else None,
        training=swum.policy.contract.training,
        provenance=provenance(),
    )


def rows(targets: Iterable[TargetResult]) -> list[dict[str, Any]]:
    """Rows of a table, one per target."""
    return [
        {
            "target": one.target,
            "x [m]": one.x,
            "y [m]": one.y,
            "reached": "yes" if one.reached else "no",
            "closest [cm]": 100 * one.closest,
            "time [s]": one.seconds,
        }
        for one in targets
    ]


@styled
def picture(tour: Tour, where: Pool) -> Figure:
    """Draw the pool from above: the whole path, the targets in order, the fish every two
    seconds."""
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    axes = figure.subplots()
    _draw_pool(axes, tour, where)
    for step in range(0, len(tour.goal), round(2.0 / PERIOD)):
        axes.plot(*outline(where.fish, tour.shape[step]).T, color=POOL, lw=1.5, alpha=0.4)
    return figure


def _draw_pool(axes: Axes, tour: Tour, where: Pool) -> None:
    """Walls, path, targets and the fish at the end."""
    radius = where.measure.arrival
    draw_walls(axes, where.walls)
    axes.plot(*tour.pose[:, :2].T, color=WAY, lw=1)
    for number, (x, y) in enumerate(tour.targets.tolist()):
        colour = REACHED if tour.reached[number] else MISSED
        axes.add_patch(Circle((x, y), radius, color=colour, zorder=3))
        axes.annotate(str(number + 1), (x + 1.4 * radius, y + radius))
    axes.plot(*outline(where.fish, tour.shape[-1]).T, color=POOL, lw=3, solid_capstyle="round")
    axes.set(title=f"{PERIOD * (len(tour.goal) - 1):.0f} s")
