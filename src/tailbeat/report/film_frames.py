"""A film's frames, rendered by MuJoCo without a screen, in several processes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import mujoco
import mujoco.gl_context
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tailbeat.evaluate.motion import Motion, followed
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.processes import spawn
from tailbeat.report import film_marks as marks
from tailbeat.report import pool_pictures as pictures
from tailbeat.report.pool_scene import View, build_scene

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Side = Literal["follow", "side"]
WORKERS = 2  # most processes; more would wait for the encoder
FEW = 100  # frames that one process renders before a second would have started
GEOMS = 2000  # most geoms of a scene
FOLLOW_DISTANCE, FOLLOW_ELEVATION, FOLLOW_BESIDE = 1.35, -40.0, 34.0  # m, deg, deg from its tail
SIDE_DISTANCE, SIDE_ELEVATION = 0.75, -46.0  # fraction of the pool's length; deg
LIGHTS_OFF = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION,
              mujoco.mjtRndFlag.mjRND_HAZE, mujoco.mjtRndFlag.mjRND_FOG)  # fmt: skip


class NoPicture(BadInput):
    """No GL library can render on this machine."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What to film, and from where."""

    fish: Fish
    motion: Motion
    side: Side = "follow"
    view: View = field(default_factory=View)


def camera_of(shot: Shot, frame: int, follow: tuple[Array, Array]) -> mujoco.MjvCamera:
    """The camera of a frame; `follow` is `followed(shot.motion)`."""
    camera = mujoco.MjvCamera()
    if shot.side == "side":
        camera.lookat[:] = [0, 0.08, -0.2]
        camera.distance = max(SIDE_DISTANCE * shot.view.pool[0], 1.5 * shot.view.pool[1])
        camera.azimuth, camera.elevation = 90.0, SIDE_ELEVATION
        return camera
    place, yaw = follow
    camera.lookat[:] = [*place[frame], -0.1]
    camera.distance, camera.elevation = FOLLOW_DISTANCE, FOLLOW_ELEVATION
    camera.azimuth = np.degrees(yaw[frame]) + FOLLOW_BESIDE
    return camera


def rendered(shot: Shot, chosen: range) -> Iterator[Picture]:
    """Render the chosen frames (height, width, 3). Raises NoPicture if no GL library works."""
    model = build_scene(shot.fish, shot.view)
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, GEOMS)
    for flag in LIGHTS_OFF:
        scene.flags[flag] = 0
    options = mujoco.MjvOption()
    options.flags[mujoco.mjtVisFlag.mjVIS_TENDON] = 0
    options.sitegroup[:] = 0
    wake = marks.wake_of(marks.tail_tips(model, shot.motion), shot.motion.rate)
    follow = followed(shot.motion)
    with _context(model, shot.view) as context:
        turn = -1
        for frame in chosen:
            _place(model, data, shot.motion, frame)
            camera = camera_of(shot, frame, follow)
            every = mujoco.mjtCatBit.mjCAT_ALL
            mujoco.mjv_updateScene(model, data, options, None, camera, every, scene)
            marks.add_shadow(scene, model, data)
            marks.add_wake(scene, wake, frame / shot.motion.rate)
            marks.add_reached(scene, shot.motion, frame)
            turn = _turn_light(model, context, frame / shot.motion.rate, turn)
            yield _read(context, scene, shot.view)


def _place(model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, frame: int) -> None:
    """Place fish and target; without a target, its body is far below the floor."""
    data.qpos[:] = motion.qpos[frame]
    target = motion.target[frame]
    seen = not np.isnan(target).any()
    data.mocap_pos[0] = [*target, 0.0] if seen else [0.0, 0.0, -50.0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)


def _turn_light(model: mujoco.MjModel, context: mujoco.MjrContext, time: float, shown: int) -> int:
    """Show floor and surface at `time` [s], unless this step of their loop is shown; returns the
    step."""
    turn = int(time * pictures.TURNS / pictures.LOOP) % pictures.TURNS
    if turn == shown:
        return turn
    for name, picture in (("tiles", pictures.lit_tiles(turn)), ("surface", pictures.surface(turn))):
        texture = model.texture(name).id
        first = model.tex_adr[texture]
        model.tex_data[first : first + picture.size] = picture.ravel()
        mujoco.mjr_uploadTexture(model, context, texture)
    return turn


def _read(context: mujoco.MjrContext, scene: mujoco.MjvScene, view: View) -> Picture:
    """Render and scale down."""
    width, height = view.rendered
    whole = mujoco.MjrRect(0, 0, width, height)
    mujoco.mjr_render(whole, scene, context)
    image = np.empty((height, width, 3), np.uint8)
    mujoco.mjr_readPixels(image, None, whole, context)
    small = Image.fromarray(image).resize((view.width, view.height), Image.Resampling.BOX)
    return np.asarray(small)[::-1]


@contextmanager
def _context(model: mujoco.MjModel, view: View) -> Iterator[mujoco.MjrContext]:
    """A context to render in. Raises NoPicture."""
    made = getattr(mujoco.gl_context, "GLContext", None)
    try:
        if made is None:
            raise RuntimeError("MUJOCO_GL=disable")
        surface = made(*view.rendered)
        surface.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    except Exception as error:  # whatever a missing EGL or OSMesa raises
        raise NoPicture(
            f"no GL library renders here ({_first_line(error)}); install libegl1, or set"
            f" MUJOCO_GL=osmesa with libosmesa6 installed."
        ) from None
    try:
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        yield context
    finally:
        context.free()
        surface.free()


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0] or type(error).__name__


# ---- in several processes -----------------------------------------------------------------------


def frames(shot: Shot) -> Iterator[Picture]:
    """Every frame in order, rendered by one process per core, at most two, and by one if they are
    few. Raises NoPicture."""
    count = min(WORKERS, os.cpu_count() or 1, 1 + shot.motion.frames // FEW)
    started = [
        spawn(_work, shot, range(first, shot.motion.frames, count)) for first in range(count)
    ]
    try:
        shape = (shot.view.height, shot.view.width, 3)
        for frame in range(shot.motion.frames):
            _, pipe = started[frame % count]
            yield np.frombuffer(_receive(pipe), np.uint8).reshape(shape)
    finally:
        for worker, _ in started:
            worker.terminate()
            worker.join()


def _receive(end: Any) -> bytes:
    try:
        sent = end.recv()
    except EOFError:
        raise NoPicture("the process that renders ended; see its message above.") from None
    if isinstance(sent, Exception):
        raise sent
    return bytes(sent)


def _work(shot: Shot, chosen: range, end: Any) -> None:
    """The process: renders the chosen frames and sends each. Mesa's software renderer gets one
    thread, because there is a process for each core."""
    os.environ.setdefault("LP_NUM_THREADS", "1")
    try:
        for image in rendered(shot, chosen):
            end.send(image.tobytes())
    except BadInput as error:
        end.send(error)
