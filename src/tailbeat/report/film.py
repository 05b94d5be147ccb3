"""A film of a fish in its pool, in 3-D, from the log of its run or from a tour."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tailbeat.evaluate.motion import Span, of_log
from tailbeat.evaluate.trial import Progress
from tailbeat.files import BadInput, new_file
from tailbeat.link.places import POOL
from tailbeat.report.film_frames import Shot, Side, frames
from tailbeat.report.pool_scene import View

Picture = NDArray[np.uint8]
MOVIE, ANIMATED = ".mp4", (".webp", ".gif")
SIZES = {MOVIE: (960, 540), ".webp": (640, 360), ".gif": (480, 270)}  # px, by suffix
RATES = {
    MOVIE: 30.0,
    ".webp": 20.0,
    ".gif": 12.5,
}  # frames per second; a GIF's times are multiples of 10 ms
MOVIE_QUALITY = 6.0  # of 10
LIMIT = 5_000_000  # bytes, largest animated picture, so that a page with it loads fast
QUALITIES = {".webp": (80, 65, 50, 35, 20), ".gif": (128, 64, 32, 16)}  # of 100; colours
LONGEST = 600.0  # s


@dataclass(frozen=True)
class FilmConfig:
    """Film the run of `log` as `out`, whose suffix gives the format: MP4, WebP or GIF. `side` is
    the camera's position; `fish` names the fish that swam, None is the one that the log tells;
    `pool` is the pool's length and width [m]."""

    log: Path
    out: Path
    span: Span = field(default_factory=Span)
    side: Side = "follow"
    fish: str | None = None
    pool: tuple[float, float] = POOL


@dataclass(frozen=True)
class Film:
    """A written film: `frames` at a `rate` [Hz] that show `seconds` of the run, the file's size,
    and the time [s] that it took. `whole` is false for an incomplete log."""

    file: str
    frames: int
    rate: float
    seconds: float
    bytes: int
    took_s: float
    whole: bool = True


def film(config: FilmConfig, progress: Progress) -> Film:
    """Film a run's log.

    Raises BadInput for a log without the fields that a film needs, for a suffix other than MP4,
    WebP and GIF, and for a path that cannot be written. Also if no GL library renders.
    """
    from tailbeat.robot.log import is_whole  # needs the extra
    from tailbeat.robot.logged import fish_in

    began, rate = time.monotonic(), rate_of(config.out)
    if not 0.5 <= config.span.seconds <= LONGEST:
        raise BadInput(f"--seconds {config.span.seconds:g}: allowed are 0.5 to {LONGEST:g}.")
    if config.span.start is not None and not config.span.start >= 0:
        raise BadInput(f"--start {config.span.start:g}: give 0 or more.")
    fish = fish_in(config.log, config.fish)
    motion = of_log(config.log, fish, config.span, rate)
    width, height = SIZES[config.out.suffix]
    shot = Shot(fish, motion, config.side, View(width, height, config.pool))
    write(shot, config.out, progress)
    return Film(
        file=str(config.out),
        frames=motion.frames,
        rate=rate,
        seconds=motion.frames / rate,
        bytes=config.out.stat().st_size,
        took_s=time.monotonic() - began,
        whole=is_whole(config.log),
    )


def rate_of(out: Path) -> float:
    """Frames per second of a film with this suffix. Raises BadInput."""
    if out.suffix not in RATES:
        raise BadInput(f"--out {out}: unknown format; allowed are {', '.join(RATES)}.")
    return RATES[out.suffix]


def write(shot: Shot, out: Path, progress: Progress, overwrite: bool = False) -> None:
    """Render a shot and write it. Raises BadInput."""
    with new_file(out, overwrite) as beside:
        images = _counted(shot, progress)
        if out.suffix == MOVIE:
            _write_movie(images, beside, shot.motion.rate)
        else:
            _write_animated(list(map(Image.fromarray, images)), beside, shot.motion.rate)


def _counted(shot: Shot, progress: Progress) -> Iterator[Picture]:
    for number, image in enumerate(frames(shot), 1):
        yield image
        progress("film", number, shot.motion.frames)


def _write_movie(images: Iterator[Picture], path: Path, rate: float) -> None:
    first = next(images)  # an error of rendering comes before a file is begun
    with imageio.get_writer(path, fps=rate, macro_block_size=None, quality=MOVIE_QUALITY) as writer:
        writer.append_data(first)  # type: ignore[attr-defined]
        for image in images:
            writer.append_data(image)  # type: ignore[attr-defined]


def _write_animated(images: list[Image.Image], path: Path, rate: float) -> None:
    """Write with the best quality that fits into the limit. Raises BadInput for a film that is too
    long."""
    save: Callable[[list[Image.Image], Path, float, int], None]
    save = _save_webp if path.suffix == ".webp" else _save_gif
    for quality in QUALITIES[path.suffix]:
        save(images, path, rate, quality)
        if os.path.getsize(path) <= LIMIT:
            return
    raise BadInput(
        f"--out: {len(images) / rate:.1f} s of film do not fit into {LIMIT / 1e6:g} MB as"
        f" {path.suffix}; give fewer --seconds, or .mp4."
    )


def _save_webp(images: list[Image.Image], path: Path, rate: float, quality: int) -> None:
    images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 / rate),
                   loop=0, quality=quality, method=4)  # fmt: skip


def _save_gif(images: list[Image.Image], path: Path, rate: float, colours: int) -> None:
    """Write all frames with the palette of the middle one, without dither: unchanged pixels are not
    stored."""
    none = Image.Dither.NONE
    palette = images[len(images) // 2].quantize(colours, dither=none)
    few = [image.quantize(palette=palette, dither=none) for image in images]
    few[0].save(path, save_all=True, append_images=few[1:], duration=round(1000 / rate), loop=0)
