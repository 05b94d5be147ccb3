"""Pictures and films of a twin, by MuJoCo's renderer; without GL, a top view by matplotlib."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import imageio.v2 as imageio
import matplotlib
import mujoco
import mujoco.gl_context
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tailbeat.files import new_file
from tailbeat.fish.description import length_of
from tailbeat.fish.proportions import LENGTH
from tailbeat.fish.twin import Twin

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
WIDTH, HEIGHT = 960, 540
FILM_WIDTH, FILM_HEIGHT = 640, 360  # software rendering is slow
FILM_RATE = 25

matplotlib.use("Agg")


def frames(
    twin: Twin, qpos: Array, size: tuple[int, int] = (WIDTH, HEIGHT), camera: str = "beside"
) -> tuple[Iterator[Image], str]:
    """One image (height, width, 3) per row of qpos (k, nq), and how: "mujoco" or "drawn".

    Without a working GL library the images are a drawn top view; this raises no error.
    """
    if _needs_missing_screen():
        return _drawn(twin, qpos, size), "drawn"
    try:
        renderer = mujoco.Renderer(twin.model, size[1], size[0])
    except Exception:  # whatever a missing EGL, OSMesa or display raises: draw instead
        return _drawn(twin, qpos, size), "drawn"
    return _rendered(twin, renderer, qpos, camera), "mujoco"


def _needs_missing_screen() -> bool:
    """Whether MuJoCo, imported before tailbeat, chose GLFW without a screen: GLFW would abort."""
    context = getattr(mujoco.gl_context, "GLContext", None)
    screen = "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    glfw = context is None or context.__module__.startswith("mujoco.glfw")
    return sys.platform == "linux" and glfw and not screen


def _rendered(twin: Twin, renderer: mujoco.Renderer, qpos: Array, camera: str) -> Iterator[Image]:
    data = mujoco.MjData(twin.model)
    with renderer:
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_forward(twin.model, data)
            renderer.update_scene(data, camera)
            yield renderer.render()


def _drawn(twin: Twin, qpos: Array, size: tuple[int, int]) -> Iterator[Image]:
    """The wetted ellipsoids seen from above, in a window that follows the fish."""
    data = mujoco.MjData(twin.model)
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.07, 0.09, 0.91, 0.88))
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(twin.model, data)
        _draw_top(axes, twin.model, data, length_of(twin.fish) / LENGTH)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw_top(
    axes: matplotlib.axes.Axes, model: mujoco.MjModel, data: mujoco.MjData, scale: float
) -> None:
    """`scale`: the fish's length over the pulley fish's."""
    axes.clear()
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        half = model.geom_size[geom]
        turn = data.geom_xmat[geom].reshape(3, 3)[:2, :2]
        round_ = np.linspace(0, 2 * np.pi, 30)
        rim = (
            data.geom_xpos[geom, :2]
            + np.stack([half[0] * np.cos(round_), half[1] * np.sin(round_)], axis=1) @ turn.T
        )
        axes.fill(*rim.T, color="tab:blue", alpha=0.6)
    x, y = data.body("head").xpos[:2]
    along, across = (x - 0.7 * scale, x + 0.4 * scale), (y - 0.31 * scale, y + 0.31 * scale)
    axes.set(xlim=along, ylim=across, xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)


def save_picture(twin: Twin, qpos: Array, path: Path, overwrite: bool = False) -> str:
    """Write one PNG of one state (nq,). Returns how it was made, "mujoco" or "drawn". Raises
    BadInput if `path` exists and `overwrite` is false."""
    images, how = frames(twin, qpos[None])
    with new_file(path, overwrite) as beside:
        imageio.imwrite(beside, next(images))
    return how


def save_film(twin: Twin, time: Array, qpos: Array, path: Path, overwrite: bool = False) -> str:
    """Write an MP4 at real speed of states qpos (k, nq) at `time` (k,) [s]. Returns how it was
    made, "mujoco" or "drawn". Raises BadInput if `path` exists and `overwrite` is false."""
    wanted = np.arange(time[0], time[-1], 1 / FILM_RATE)
    images, how = frames(twin, qpos[np.searchsorted(time, wanted)], (FILM_WIDTH, FILM_HEIGHT))
    with (
        new_file(path, overwrite) as beside,
        imageio.get_writer(beside, fps=FILM_RATE, macro_block_size=None) as film,
    ):
        for image in images:
            film.append_data(image)  # type: ignore[attr-defined]
    return how
