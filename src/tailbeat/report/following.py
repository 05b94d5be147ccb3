"""Picture, film and page of a swim after a target by the clock. Draws what was swum."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.evaluate import following
from tailbeat.evaluate.following import Followed, FollowResult, Track
from tailbeat.evaluate.motion import Motion, Span, of_log, of_steps
from tailbeat.evaluate.provenance import Provenance, provenance
from tailbeat.evaluate.swim import Counting
from tailbeat.evaluate.track import SETTLING
from tailbeat.evaluate.trial import Progress
from tailbeat.files import BadInput, write_json
from tailbeat.report import film, html
from tailbeat.report.film_frames import Shot
from tailbeat.report.html import Block, Section
from tailbeat.report.pool_scene import View
from tailbeat.report.style import COMMAND, LIMIT, MISSED, TARGET, WAY, draw_walls, styled
from tailbeat.report.style import POOL as SWUM

FILM_SECONDS = 20.0  # from a second before the fish swims


@dataclass(frozen=True)
class FollowReport:
    """Summary of a swim after a target: policy, fish, seed, log (None for a swim in process), the
    result, and the provenance of policy and numbers."""

    policy: str
    fish: str
    seed: int
    log: str | None
    result: FollowResult
    training: Mapping[str, object]
    provenance: Provenance


def write(
    followed: Followed, out: Path, counting: Counting, film_seconds: float = FILM_SECONDS
) -> FollowReport:
    """Write summary, picture, film and page; the summary first, because a film takes long. If no
    film can be rendered, the page says why. Raises BadInput."""
    data = summary(followed)
    write_json(out / "summary.json", data, overwrite=True)
    if followed.runs is not None:  # else the station has written it
        write_json(out / "path.json", followed.record, overwrite=True)
    whole = following.track(followed.path, followed.record)
    drawn = html.figure(picture(followed, whole), out, "path")
    with counting() as progress:
        shown = _film(followed, out / "swim.mp4", film_seconds, progress)
    told = [Block("warning", one) for one in data.result.faults]
    origin = html.values({**vars(data.provenance), **data.training})
    blocks = (*told, html.values(row(data.result)), drawn, shown)
    sections = [Section("The swim", blocks), Section("Provenance", (origin,))]
    html.write(out, sections, data, f"{data.fish} after a moving target")
    return data


def summary(followed: Followed) -> FollowReport:
    """Summarise a swim. Raises BadInput."""
    return FollowReport(
        policy=followed.config.policy,
        fish=followed.pool.fish.name,
        seed=followed.config.seed,
        log=None if followed.log is None else str(followed.log),
        result=following.result(followed),
        training=followed.policy.contract.training,
        provenance=provenance(),
    )


def row(done: FollowResult) -> dict[str, Any]:
    """The result as a row of a table."""
    counts = (done.crossings, done.crossings_over_2_s)
    crossed = [None if one is None else f"{one} of {done.of}" for one in counts]
    return {
        "path": done.path,
        "time [s]": done.seconds,
        "target [m/s]": done.target_speed,
        "mean [cm]": 100 * done.mean_distance,
        "median [cm]": 100 * done.median_distance,
        "95 % [cm]": 100 * done.p95_distance,
        "aside, rms [cm]": 100 * done.aside_rms,
        f"kept within {100 * done.kept_within:.3g} cm": "yes" if done.kept else "no",
        "clean crossings": crossed[0],
        "direction over 2 s": crossed[1],
        "holds": len(done.holds),
    }


def _film(followed: Followed, path: Path, seconds: float, progress: Progress) -> Block:
    """The film of the swim's first seconds, or a warning why there is none."""
    path.unlink(missing_ok=True)  # the film of an earlier swim
    try:
        motion = _motion(followed, Span(seconds), film.rate_of(path))
        where, view = followed.pool, View(pool=followed.pool.walls)
        film.write(Shot(where.fish, motion, "side", view), path, progress)
    except BadInput as error:
        return Block("warning", f"There is no film: {error}")
    return html.film(path)


def _motion(followed: Followed, span: Span, rate: float) -> Motion:
    runs = followed.runs
    if followed.log is not None:
        return of_log(followed.log, followed.pool.fish, span, rate)
    assert runs is not None
    shape, pose, target = (
        one[0].astype(np.float64) for one in (runs.shape, runs.pose, runs.target)
    )
    return of_steps(shape, pose, target, span, rate)


@styled
def picture(followed: Followed, whole: Track) -> Figure:
    """Draw the path with the fish's track from above, and below it the distance over time."""
    figure = Figure(figsize=(9, 7.2), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(2.2, 1))
    _draw_pool(above, whole, followed)
    _draw_distance(below, whole, followed)
    return figure


def _draw_pool(axes: Axes, whole: Track, followed: Followed) -> None:
    draw_walls(axes, followed.pool.walls)
    axes.plot(*followed.path.places.T, color=WAY, lw=1, label="path")
    axes.plot(*whole.target.T, color=TARGET, lw=2, label="target")
    axes.plot(*whole.tag.T, color=SWUM, lw=1.2, label="fish's tag")
    axes.plot(*whole.target[0], "o", color=TARGET)
    axes.plot(*whole.tag[:1].T, "o", color=SWUM)
    axes.legend(loc="upper right")


def _draw_distance(axes: Axes, whole: Track, followed: Followed) -> None:
    axes.plot(whole.after, 100 * whole.distance, color=SWUM)
    measure = followed.pool.measure
    limit = 100 * following.KEPT * measure.reach
    axes.axhline(limit, color=LIMIT, ls="--", lw=1, label=f"{limit:g} cm")
    axes.axvspan(0, min(SETTLING * measure.time, whole.after[-1]), color=COMMAND, alpha=0.15, lw=0)
    for number, one in enumerate(followed.record.holds):
        axes.axvline(one.after, color=MISSED, lw=1, label="hold" if number == 0 else None)
    axes.set(xlabel="time after the start [s]", ylabel="distance [cm]")
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper right")
