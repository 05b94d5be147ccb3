"""Pictures of a world: from above with path and target, and the twin in 3-D."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.files import new_file
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline
from tailbeat.fish.render import frames
from tailbeat.fish.twin import Options, compile_twin

Array = NDArray[np.float64]
FILM_RATE, SPEED = 12.5, 8.0  # frames per second, seconds swum per second shown


def from_above(world: World, fish: int, path: Array, pixels: int = 480) -> NDArray[np.uint8]:
    """Draw one fish, its path (k, 3) and its target from above: an image (pixels, pixels, 3)."""
    figure = Figure(figsize=(4, 4), dpi=pixels / 4, layout="constrained")
    canvas, axes = FigureCanvasAgg(figure), figure.subplots()
    axes.plot(path[:, 0], path[:, 1], color="0.7", lw=1)
    simulator = outline(world.fish, world.simulator.qpos[fish])
    axes.plot(simulator[:, 0], simulator[:, 1], color="tab:blue", lw=2.5, solid_capstyle="round")
    place = world.target[fish]
    axes.add_patch(Circle((place[0], place[1]), world.task.arrival, color="tab:orange"))
    reach = world.task.farthest + 0.5
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def from_beside(world: World, fish: int) -> NDArray[np.uint8]:
    """Render one fish in 3-D with its textures, by a camera that follows it."""
    twin = compile_twin(world.fish, Options(looks=True))
    images, _ = frames(twin, world.simulator.qpos[fish : fish + 1].copy())
    return next(images)


def film(
    decide: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    fish: Fish,
    settings: Settings,
    path: Path,
    seeds: tuple[int, ...] = (1, 2),
) -> None:
    """Write an MP4 of one greedy episode per seed from above, at eight times real speed."""
    every = round(SPEED / FILM_RATE / PERIOD)
    with (
        new_file(path, overwrite=True) as beside,
        imageio.get_writer(beside, fps=FILM_RATE, macro_block_size=None) as writer,
    ):
        for seed in seeds:
            for image in _episode(decide, World(fish, settings, [seed]), every):
                writer.append_data(image)  # type: ignore[attr-defined]


def _episode(decide: Any, world: World, every: int) -> Iterator[NDArray[np.uint8]]:
    seen, path, over = world.reset(), [world.pose[0].copy()], False
    while not over:
        done = world.step(np.asarray(decide(seen), dtype=np.float64))
        seen, over = done.observation, bool(done.terminated[0] | done.truncated[0])
        path.append(world.pose[0].copy())
        if over or len(path) % every == 0:
            yield from_above(world, 0, np.array(path))
