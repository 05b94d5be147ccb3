"""The main job: a shipped policy swims to one target after the other in the virtual pool."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, decide
from tailbeat.evaluate.scenes import TRIES
from tailbeat.evaluate.swim_figures import BLUE, GREEN, ORANGE, RED
from tailbeat.evaluate.trial import Progress
from tailbeat.files import BadInput, new_file
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline
from tailbeat.learn.body import PERIOD
from tailbeat.learn.world import Settings, Task, World
from tailbeat.pool.body import PoolBody
from tailbeat.pool.plant import LENGTH, WIDTH, Surroundings
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
WALLS = (LENGTH, WIDTH)
PATIENCE = 30.0  # s for one target
APART = 0.8  # m between one target and the next
MARGIN = 0.65  # m that targets keep from the walls: room for the fish to turn behind them
FILM_RATE = 12.5  # frames per second
SPEED, LONGEST = 4.0, 60.0  # seconds swum per second shown, at least; s that a film lasts at most


@dataclass(frozen=True, eq=False)
class Tour:
    """A swim past `targets` (m, 2): `shape` (k, nv) and `pose` (k, 3) at the control steps, the
    index of the `goal` at each (k,), and per target whether and when it was `reached`, with the
    closest approach [m]."""

    targets: Array
    shape: Array
    pose: Array
    goal: NDArray[np.int64]
    reached: NDArray[np.bool_]
    seconds: Array
    nearest: Array

    def rows(self) -> list[dict[str, Any]]:
        """One row per target."""
        return [
            {
                "target": number + 1,
                "x [m]": float(place[0]),
                "y [m]": float(place[1]),
                "reached": "yes" if self.reached[number] else "no",
                "closest [cm]": 100 * float(self.nearest[number]),
                "time [s]": float(self.seconds[number]),
            }
            for number, place in enumerate(self.targets)
        ]


def draw_targets(count: int, seed: int) -> Array:
    """Places (count, 2) inside the paper's pool, each well apart from the one before."""
    rng, room = np.random.default_rng(seed), np.array(WALLS) / 2 - MARGIN
    places = [np.zeros(2)]
    for _ in range(TRIES * count):
        place = rng.uniform(-room, room)
        if np.hypot(*(place - places[-1])) > APART:
            places.append(place)
        if len(places) > count:
            return np.array(places[1:])
    raise BadInput(f"{count} targets do not fit into the pool; ask for fewer.")


def tour(
    policy: Policy, fish: Fish, water: Water, targets: Array, seed: int, progress: Progress
) -> Tour:
    """Swim to each target until it is within 5 cm or its time is over; from the pool's middle."""
    total = PATIENCE * len(targets)
    settings = Settings(policy.contract.actions, Task(seconds=total))
    body = PoolBody(fish, [water], [Surroundings(walls=WALLS)])
    world, choose = World(fish, settings, [seed], body=body), partial(decide, policy)
    shape, pose, goal, ends = [], [], [], []
    world.reset()
    world.drift[:], world.seen.frames[..., 3:5] = 0.0, targets[0]
    seen = world.reset(np.zeros(1, bool))
    for number, place in enumerate(targets):
        world.target[0], nearest = place, np.inf
        for _ in range(round(PATIENCE / PERIOD)):
            done = world.step(np.asarray(choose(seen), dtype=np.float64))
            seen = done.observation
            shape.append(world.body.qpos[0].copy())
            pose.append(world.pose[0].copy())
            goal.append(number)
            nearest = min(nearest, float(np.hypot(*(place - world.pose[0, :2]))))
            if done.reached[0]:
                break
        progress("targets", number + 1, len(targets))
        ends.append((bool(done.reached[0]), PERIOD * goal.count(number), nearest))
    reached, seconds, closest = map(np.array, zip(*ends, strict=True))
    return Tour(targets, np.array(shape), np.array(pose), np.array(goal), reached, seconds, closest)


# ---- pictures -----------------------------------------------------------------------------------


def picture(tour: Tour, fish: Fish) -> Figure:
    """The pool from above: the whole way, the targets in their order, the fish now and then."""
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    axes = figure.subplots()
    _draw(axes, tour, fish, len(tour.goal) - 1, len(tour.goal))
    for step in range(0, len(tour.goal), round(2.0 / PERIOD)):
        axes.plot(*outline(fish, tour.shape[step]).T, color=BLUE, lw=1.5, alpha=0.4)
    return figure


def film(tour: Tour, fish: Fish, path: Path, progress: Progress) -> None:
    """An MP4 of the swim from above, at four times real speed; a long swim faster, in a minute."""
    speed = max(SPEED, PERIOD * len(tour.goal) / LONGEST)
    with (
        new_file(path, overwrite=True) as beside,
        imageio.get_writer(beside, fps=FILM_RATE, macro_block_size=None) as writer,
    ):
        steps = range(0, len(tour.goal), round(speed / FILM_RATE / PERIOD))
        for number, image in enumerate(_images(tour, fish, steps), 1):
            writer.append_data(image)  # type: ignore[attr-defined]
            progress("film", number, len(steps))


def _images(tour: Tour, fish: Fish, steps: range) -> Iterator[Any]:
    figure = Figure(figsize=(8, 4.4), dpi=80)
    canvas, axes = FigureCanvasAgg(figure), figure.add_axes((0.06, 0.1, 0.92, 0.82))
    for step in steps:
        axes.clear()
        _draw(axes, tour, fish, step, step)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw(axes: Axes, tour: Tour, fish: Fish, step: int, shown: int) -> None:
    length, width = WALLS
    axes.add_patch(Rectangle((-length / 2, -width / 2), length, width, fill=False, lw=2))
    axes.plot(*tour.pose[:shown, :2].T, color="0.7", lw=1)
    for number, (x, y) in enumerate(tour.targets.tolist()):
        over = number < tour.goal[step] or shown == len(tour.goal)
        colour = (GREEN if tour.reached[number] else RED) if over else ORANGE
        if over or number == tour.goal[step]:
            axes.add_patch(Circle((x, y), 0.05, color=colour, zorder=3))
            axes.annotate(str(number + 1), (x + 0.07, y + 0.05))
    axes.plot(*outline(fish, tour.shape[step]).T, color=BLUE, lw=3, solid_capstyle="round")
    axes.set(xlim=(-2.85, 2.85), ylim=(-1.45, 1.45), xlabel="x [m]", ylabel="y [m]")
    axes.set(title=f"{PERIOD * step:.0f} s")
    axes.set_aspect("equal")


def as_json(tour: Tour) -> dict[str, Any]:
    """What the swim came to."""
    hits = tour.reached
    return {
        "targets": tour.rows(),
        "within_5cm": int(hits.sum()),
        "within_20cm": int((tour.nearest < 0.2).sum()),
        "seconds": PERIOD * len(tour.goal),
        "median_seconds": float(np.median(tour.seconds[hits])) if hits.any() else None,
    }
