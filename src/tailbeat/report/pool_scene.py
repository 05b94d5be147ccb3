"""The film's scene: a fish in its tiled pool, as an engine model that is only drawn, never
stepped."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import arrival_of
from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.looks import Colours, add_hulls
from tailbeat.fish.twin import Options, build_spec
from tailbeat.link.places import POOL
from tailbeat.report import pool_pictures as pictures

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
FINER = 1.5  # rendered size over shown size, for smooth edges
DEPTH = 0.6  # m of water, chosen; so are all lengths and colours here
RIM, DECK, LIP = 0.05, 0.30, 0.015  # m: height above the water and width of the coping; how far
# it reaches over the walls, so that no two faces lie in one plane
SUNK = 0.03  # m from the surface to the highest point of fish and tag
PLATE = 0.1  # m: side of the tag's sheet, white border included
SKY_HIGH, SKY_LOW = [0.50, 0.62, 0.70], [0.72, 0.79, 0.82]
COPING, GROUND = [0.72, 0.72, 0.69, 1.0], [0.55, 0.58, 0.57, 1.0]
SUN = [0.12, 0.16, -1.0]  # direction of its light
WATERY, SWELL = 0.16, 1.37  # opacity of the surface; size of its glints over the floor's light
COLOURS = Colours([0.09, 0.17, 0.27, 1.0], [1.0, 0.52, 0.16, 1.0], [1.0, 0.66, 0.26, 1.0])
BUOY = [1.0, 0.46, 0.10, 1.0]
PLANE, BOX = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX


@dataclass(frozen=True)
class View:
    """Size of a picture [px], and the pool's length and width [m]."""

    width: int = 960
    height: int = 540
    pool: tuple[float, float] = POOL

    @property
    def rendered(self) -> tuple[int, int]:
        """Width and height of the rendered picture [px], before it is scaled down."""
        return round(FINER * self.width), round(FINER * self.height)


def build_scene(fish: Fish, view: View) -> mujoco.MjModel:
    """A model with the fish's own joints first and a mocap body `target`; the water's surface is
    z = 0 and the pool's middle the origin."""
    spec = build_spec(fish, Options())
    spec.body("head").pos = [0, 0, -sunk(fish)]
    add_hulls(spec, fish, COLOURS)
    _set_visual(spec, view)
    _add_textures(spec, fish)
    _add_pool(spec, view.pool)
    _add_tag(spec, fish)
    _add_target(spec, arrival_of(length_of(fish)))
    return spec.compile()


def sunk(fish: Fish) -> float:
    """Depth of the fish's frame [m], so that its highest part is just under water."""
    parts = [part for body in (fish.head, *fish.tail.links) for part in body.parts]
    tops = [part.position[2] + part.size[2] / 2 for part in parts]
    return max(*tops, fish.tracked[2]) + SUNK


def _set_visual(spec: mujoco.MjSpec, view: View) -> None:
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = view.rendered
    visual.quality.offsamples = 0  # larger pictures, scaled down, cost less without a GPU
    visual.headlight.ambient, visual.headlight.diffuse = [0.55] * 3, [0.12] * 3
    visual.headlight.specular = [0.0] * 3
    spec.stat.extent, spec.stat.center = 3.0, [0, 0, 0]
    visual.map.znear, visual.map.zfar = 0.01, 20.0
    sun = spec.worldbody.add_light(pos=[0, 0, 4], dir=SUN)
    sun.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    sun.diffuse, sun.ambient, sun.specular = [0.5] * 3, [0.0] * 3, [0.3] * 3
    sun.castshadow = False


def _add_textures(spec: mujoco.MjSpec, fish: Fish) -> None:
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2, sky.width, sky.height = SKY_HIGH, SKY_LOW, 64, 384
    _add_material(spec, "tiles", pictures.lit_tiles(0), pictures.SIDE)
    _add_material(spec, "surface", pictures.surface(0), SWELL * pictures.SIDE, WATERY)
    _add_material(spec, "tag", pictures.tag(0), None)


def _add_material(
    spec: mujoco.MjSpec, name: str, picture: Picture, side: float | None, opacity: float = 1.0
) -> None:
    """A texture that repeats every `side` [m], or covers its geom once."""
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.height, texture.width, texture.nchannel = picture.shape
    texture.data = np.ascontiguousarray(picture).tobytes()
    material = spec.add_material(name=name)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    material.rgba = [1, 1, 1, opacity]
    if side is not None:
        material.texuniform, material.texrepeat = True, [1 / side, 1 / side]
    material.specular, material.shininess = 0.0, 0.0


def _add_pool(spec: mujoco.MjSpec, pool: tuple[float, float]) -> None:
    """Add floor, four walls, a coping around them, the ground, and the water's surface."""
    length, width = pool
    _add_plane(spec, [0, 0, -DEPTH], [length / 2, width / 2], [0, 0, 1], "tiles")
    middle = (RIM - DEPTH) / 2
    for sign in (-1, 1):
        tall = (RIM + DEPTH) / 2
        _add_plane(spec, [sign * length / 2, 0, middle], [width / 2, tall], [-sign, 0, 0], "tiles")
        _add_plane(spec, [0, sign * width / 2, middle], [length / 2, tall], [0, -sign, 0], "tiles")
        half = (DECK + LIP) / 2
        across, along = (sign * (side / 2 + DECK - half) for side in (width, length))
        _add_slab(spec, [0, across, RIM], [length / 2 + DECK, half], COPING)
        _add_slab(spec, [along, 0, RIM], [half, width / 2 - LIP], COPING)
        far = width / 2 + DECK + 5
        _add_slab(spec, [0, sign * far, RIM - 0.02], [length / 2 + 10, 5], GROUND)
        far = length / 2 + DECK + 5
        _add_slab(spec, [sign * far, 0, RIM - 0.02], [5, width / 2 + DECK], GROUND)
    _add_plane(spec, [0, 0, 0], [length / 2, width / 2], [0, 0, 1], "surface")


def _add_plane(
    spec: mujoco.MjSpec, place: list[float], half: list[float], normal: list[float], material: str
) -> None:
    up = [0, 1, 0] if normal[2] else [0, 0, 1]
    turn, quat = np.column_stack([np.cross(up, normal), up, normal]), np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.astype(float).ravel())
    spec.worldbody.add_geom(
        type=PLANE, pos=place, size=[*half, 1.0], quat=quat, material=material, mass=0
    )


def _add_slab(spec: mujoco.MjSpec, top: list[float], half: list[float], rgba: list[float]) -> None:
    """A box whose upper face is at `top`."""
    thick = 0.02
    place = [*top[:2], top[2] - thick]
    spec.worldbody.add_geom(type=BOX, pos=place, size=[*half, thick], rgba=rgba, mass=0)


def _add_tag(spec: mujoco.MjSpec, fish: Fish) -> None:
    x, y, z = fish.tracked
    thick = 0.0015
    spec.body("head").add_geom(
        name="tag",
        type=BOX,
        pos=[x, y, z - thick],
        size=[PLATE / 2, PLATE / 2, thick],
        material="tag",
        mass=0,
        group=1,
    )


def _add_target(spec: mujoco.MjSpec, arrival: float) -> None:
    """Add a floating ring of the arrival's size with a buoy in its middle."""
    body = spec.worldbody.add_body(name="target", mocap=True)
    vertices, faces = _ring(arrival + 0.02, 0.012)
    mesh = spec.add_mesh(name="ring")
    mesh.uservert, mesh.userface = vertices.ravel().tolist(), faces.ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ring", rgba=BUOY, mass=0, pos=[0, 0, 0.004]
    )
    pole = mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(type=pole, size=[0.004, 0.09, 0], pos=[0, 0, 0.09], rgba=[0.95] * 3 + [1], mass=0)
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    body.add_geom(type=ball, size=[0.028, 0, 0], pos=[0, 0, 0.18], rgba=BUOY, mass=0)


def _ring(radius: float, thick: float) -> tuple[Array, NDArray[np.int64]]:
    """A torus about z: vertices (n, 3) [m] and faces (m, 3)."""
    round_, count, across = 48, 48, 12
    a = np.linspace(0, 2 * np.pi, round_, endpoint=False)[:, None]
    b = np.linspace(0, 2 * np.pi, across, endpoint=False)
    out = radius + thick * np.cos(b)
    points = np.stack([out * np.cos(a), out * np.sin(a), thick * np.sin(b) + 0 * a], axis=-1)
    i, j = np.meshgrid(np.arange(count), np.arange(across), indexing="ij")
    here, on = i * across + j, i * across + (j + 1) % across
    next_, both = (i + 1) % count * across + j, (i + 1) % count * across + (j + 1) % across
    faces = np.stack([np.stack([here, next_, on], -1), np.stack([on, next_, both], -1)], 2)
    return points.reshape(-1, 3), faces.reshape(-1, 3)
