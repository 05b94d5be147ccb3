"""What a film draws besides the bodies: the fish's shadow, its fading wake, targets that it
reached.

These are geoms of the rendered scene, not of the model: each frame adds its own.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat.evaluate.motion import Motion
from tailbeat.report.pool_scene import DEPTH, SUN

Array = NDArray[np.float64]
WAKE_SECONDS, WAKE_RATE = 4.5, 45.0  # duration of a visible wake [s]; its pieces per second
NARROW, WIDE = 0.004, 0.014  # m: half the width of a new wake and of an old one
FOAM, WAKE_OPACITY = (0.93, 0.98, 1.0), 0.42
SHADE, SHADE_OPACITY = (0.0, 0.10, 0.14), 0.14
REACHED = (0.20, 0.70, 0.38, 0.75)
JUST_BELOW = -0.004  # m: just under the water's surface
LARGEST_SPECK = (
    1e-3  # m: smaller ellipsoids only switch the engine's fluid law off and are not drawn
)


def tail_tips(model: mujoco.MjModel, motion: Motion) -> Array:
    """Position of the rear end of the rearmost part at every frame (k, 2) [m]."""
    data, geom = mujoco.MjData(model), _rearmost(model)
    half = model.geom_size[geom, 0]
    tips = np.empty((motion.frames, 2))
    for frame, row in enumerate(motion.qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        turn = data.geom_xmat[geom].reshape(3, 3)
        tips[frame] = (data.geom_xpos[geom] - half * turn[:, 0])[:2]
    return tips


def _rearmost(model: mujoco.MjModel) -> int:
    """The wetted ellipsoid that is rearmost when the fish is straight."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return min(wetted(model), key=lambda geom: data.geom_xpos[geom, 0] - model.geom_size[geom, 0])


def wetted(model: mujoco.MjModel) -> list[int]:
    """The ellipsoids of the fish's parts."""
    round_ = model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    return np.flatnonzero(round_ & (model.geom_size[:, 0] > LARGEST_SPECK)).tolist()


def add_shadow(scene: mujoco.MjvScene, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Draw each part's shadow on the floor."""
    for geom in wetted(model):
        place = data.geom_xpos[geom].copy()
        fall = DEPTH + place[2]
        place[:2] += fall * np.array(SUN[:2]) / -SUN[2]
        place[2] = 0.004 - DEPTH
        turn = data.geom_xmat[geom].reshape(3, 3)
        yaw = np.arctan2(turn[1, 0], turn[0, 0])
        size = model.geom_size[geom] * [1.0, 1.0, 0.0] + [0.014, 0.008, 0.001]
        _add(scene, mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, place, yaw, (*SHADE, SHADE_OPACITY))


def wake_of(tips: Array, rate: float) -> Array:
    """The tips' path at `WAKE_RATE` (n, 2) [m]: a smooth curve through those at `rate` [Hz]."""
    if len(tips) < 2:
        return tips
    at = np.arange(len(tips)) / rate
    fine = np.arange(0, at[-1] + 0.5 / WAKE_RATE, 1 / WAKE_RATE)
    return np.asarray(CubicSpline(at, tips)(np.minimum(fine, at[-1])))


def add_wake(scene: mujoco.MjvScene, wake: Array, time: float) -> None:
    """Draw the tail tip's path up to `time` [s], wider and fainter with its age."""
    last, whole = int(time * WAKE_RATE + 1e-6), round(WAKE_SECONDS * WAKE_RATE)
    places = wake[max(last - whole, 0) : last + 1]
    for index in range(len(places) - 1):
        age = (len(places) - 2 - index) / whole
        first, second = places[index], places[index + 1]
        along = second - first
        half = np.hypot(*along) / 2
        if half > 1e-4:
            size = np.array([half, NARROW + (WIDE - NARROW) * age, 0.0005])
            middle = np.array([*(first + second) / 2, JUST_BELOW])
            rgba = (*FOAM, WAKE_OPACITY * (1 - age) ** 1.5)
            yaw = np.arctan2(along[1], along[0])
            _add(scene, mujoco.mjtGeom.mjGEOM_BOX, size, middle, yaw, rgba)


def add_reached(scene: mujoco.MjvScene, motion: Motion, frame: int) -> None:
    """Draw a green disc of the arrival's size at each target reached so far."""
    for when, x, y in motion.arrivals():
        if when <= frame:
            size = np.array([motion.arrival, 0.002, 0.0])
            place = np.array([x, y, 0.003])
            _add(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, size, place, 0.0, REACHED)


def _add(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Array,
    place: Array,
    yaw: float,
    rgba: tuple[float, ...],
) -> None:
    """Add one horizontal geom, turned by `yaw`, unless the scene is full."""
    if scene.ngeom >= scene.maxgeom:
        return
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([c, -s, 0, s, c, 0, 0, 0, 1.0])
    mujoco.mjv_initGeom(scene.geoms[scene.ngeom], kind, size, place, turn, np.array(rgba, "f4"))
    scene.geoms[scene.ngeom].category = mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1
