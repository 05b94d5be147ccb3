"""Meshes for pictures of a fish: hulls lofted from the description, or the user's own STL.

No mesh here has mass, contact or water force; the physics is in `twin.py`.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.bodies import Body, Part
from tailbeat.fish.description import Fish, length_of

Array = NDArray[np.float64]

RING = 28  # points around a section
STATIONS = 40  # sections along a hull
OVERLAP = 0.014  # m that a link's hull reaches ahead of its hinge, chosen
NOSE = 0.35  # fraction of the head's length that is rounded off as the nose, chosen
DRY = [0.80, 0.83, 0.86, 1.0]


@dataclass(frozen=True)
class Colours:
    """Red, green, blue and opacity (4,) of head, tail and fin, 0 to 1."""

    back: list[float]
    tail: list[float]
    fin: list[float]


COLOURS = Colours([0.16, 0.33, 0.42, 1.0], [0.88, 0.52, 0.22, 1.0], [0.95, 0.62, 0.30, 1.0])


PICTURED = 0.54  # m, the pulley fish's length, which the cameras' places suit


def add_looks(spec: mujoco.MjSpec, fish: Fish) -> None:
    """Add the pool floor, lights, cameras and one visible mesh or more per body."""
    _add_scene(spec, length_of(fish) / PICTURED)
    add_hulls(spec, fish)


def add_hulls(spec: mujoco.MjSpec, fish: Fish, colours: Colours = COLOURS) -> None:
    """Add one visible mesh or more per body, without mass or contact."""
    along = np.linspace(0, 1, STATIONS)
    head = np.tile(_nose_profile(along)[:, None], 2)
    back, tail = (colours.back, colours.fin), (colours.tail, colours.fin)
    _dress(spec, spec.body("head"), fish.head, 0.0, back, head)
    links = fish.tail.links
    for index, link in enumerate(links):
        follower = links[min(index + 1, len(links) - 1)]
        shrink = np.minimum(_hull_size(follower) / _hull_size(link), 1.0)
        taper = 1 + along[:, None] * (shrink - 1)
        _dress(spec, spec.body(f"link{index}"), link, link.hinge, tail, taper)


def _hull(described: Body) -> list[Part]:
    return [p for p in described.parts if p.zone is not None and p.zone != "fin"]


def _hull_size(described: Body) -> Array:
    """Largest width and height (2,) of a body's hull [m]; those of its parts if it has none."""
    sizes = np.array([p.size[1:] for p in _hull(described) or described.parts])
    return sizes.max(axis=0)


def _dress(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    described: Body,
    x0: float,
    colours: tuple[list[float], list[float]],
    taper: Array,
) -> None:
    """Add the meshes of one body. `colours` are the hull's and the fin's."""
    rgba, fin = colours
    if described.mesh is not None:
        _add_stl(spec, body, described, x0, rgba)
        return
    hull = _hull(described)
    if hull:
        front = x0 + OVERLAP if body.name != "head" else -np.inf
        _add_mesh(spec, body, f"{body.name}-hull", *hull_mesh(hull, taper, front), x0, rgba)
    for part in described.parts:
        if part.zone == "fin":
            _add_mesh(spec, body, part.name, *fin_mesh(part), x0, fin)
        elif part.zone is None:
            _add_dry_box(body, part, x0)


def hull_mesh(parts: list[Part], taper: Array, front: float) -> tuple[Array, Array]:
    """Loft elliptic sections along x around boxes. Returns vertices (n, 3) [m] and faces (m, 3).

    `taper` (stations, 2) scales width and height from front to rear. The hull reaches forward at
    least to x = `front` [m], so that a bent tail shows no gap.
    """
    boxes = np.array([[*p.position, *p.size] for p in parts])
    start, end = boxes[:, 0] + boxes[:, 3] / 2, boxes[:, 0] - boxes[:, 3] / 2
    x = np.linspace(max(start.max(), front), end.min(), STATIONS)
    inside = (x[:, None] <= start + 1e-9) & (x[:, None] >= end - 1e-9)
    seen = np.flatnonzero(inside.any(axis=1))
    width = _profile(seen, np.where(inside, boxes[:, 4] / 2, -np.inf).max(axis=1))
    top = _profile(seen, np.where(inside, boxes[:, 2] + boxes[:, 5] / 2, -np.inf).max(axis=1))
    low = _profile(seen, np.where(inside, boxes[:, 2] - boxes[:, 5] / 2, np.inf).min(axis=1))
    return _loft(x, width * taper[:, 0], (top + low) / 2, (top - low) / 2 * taper[:, 1])


def _profile(seen: NDArray[np.int_], values: Array) -> Array:
    """Fill stations between boxes from their neighbours and average over five."""
    filled = np.interp(np.arange(values.size), seen, values[seen])
    return np.convolve(np.pad(filled, 2, mode="edge"), np.ones(5) / 5, mode="valid")


def _nose_profile(along: Array) -> Array:
    return np.sqrt(np.clip(1 - np.square(np.clip(1 - along / NOSE, 0, 0.995)), 0, 1))


def _loft(x: Array, width: Array, middle: Array, height: Array) -> tuple[Array, Array]:
    """Closed surface through elliptic rings at `x` with half-axes `width` and `height`."""
    angle = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    rings = np.stack(
        [
            np.broadcast_to(x[:, None], (x.size, RING)),
            width[:, None] * np.cos(angle),
            middle[:, None] + height[:, None] * np.sin(angle),
        ],
        axis=-1,
    ).reshape(-1, 3)
    caps = np.array([[x[0], 0, middle[0]], [x[-1], 0, middle[-1]]])
    return np.vstack([rings, caps]), _loft_faces(x.size)


def _loft_faces(stations: int) -> Array:
    j = np.arange(RING)
    after = (j + 1) % RING
    faces = []
    for i in range(stations - 1):
        a, b = i * RING + j, i * RING + after
        faces += [np.stack([a, a + RING, b], 1), np.stack([b, a + RING, b + RING], 1)]
    front, back, last = stations * RING, stations * RING + 1, (stations - 1) * RING
    faces += [np.stack([np.full(RING, front), j, after], 1)]
    faces += [np.stack([np.full(RING, back), last + after, last + j], 1)]
    return np.vstack(faces)


def fin_mesh(part: Part) -> tuple[Array, Array]:
    """A forked, swept lens inside the part's box. Returns vertices (n, 3) [m], faces (m, 3)."""
    span = np.linspace(-1, 1, 25)
    chord, thick, height = part.size
    front = chord * (0.5 - 0.62 * np.abs(span) ** 1.3)
    rear = chord * (-0.5 + 0.30 * (1 - np.abs(span)) ** 1.2)
    middle, z = (front + rear) / 2, span * height / 2
    rows = [(front, 0.0), (middle, thick / 2), (rear, 0.0), (middle, -thick / 2)]
    vertices = np.stack([np.stack([x, np.full_like(x, y), z], 1) for x, y in rows], 1)
    return vertices.reshape(-1, 3) + part.position, _fin_faces(span.size)


def _fin_faces(count: int) -> Array:
    faces = []
    for i in range(count - 1):
        for j in range(4):
            a, b = 4 * i + j, 4 * i + (j + 1) % 4
            faces += [[a, a + 4, b], [b, a + 4, b + 4]]
    last = 4 * (count - 1)
    faces += [[0, 1, 2], [0, 2, 3], [last, last + 2, last + 1], [last, last + 3, last + 2]]
    return np.array(faces)


def _add_mesh(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    vertices: Array,
    faces: Array,
    x0: float,
    rgba: list[float],
) -> None:
    mesh = spec.add_mesh(name=f"{name}-look")
    mesh.uservert = (vertices - [x0, 0, 0]).ravel().tolist()
    mesh.userface = faces.ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # these meshes have no mass
    _add_look(body, mesh.name, rgba)


def _add_stl(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, described: Body, x0: float, rgba: list[float]
) -> None:
    look = described.mesh
    assert look is not None
    mesh = spec.add_mesh(name=f"{body.name}-look", file=look.file, scale=[look.scale] * 3)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    x, y, z = look.position
    _add_look(body, mesh.name, rgba, [x - x0, y, z])


def _add_look(
    body: mujoco.MjsBody, mesh: str, rgba: list[float], position: list[float] | None = None
) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=mesh,
        pos=position or [0, 0, 0],
        mass=0,
        contype=0,
        conaffinity=0,
        group=1,
        rgba=rgba,
    )


def _add_dry_box(body: mujoco.MjsBody, part: Part, x0: float) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[length / 2 for length in part.size],
        pos=[part.position[0] - x0, *part.position[1:]],
        mass=0,
        contype=0,
        conaffinity=0,
        group=1,
        rgba=DRY,
    )


def _add_scene(spec: mujoco.MjSpec, scale: float) -> None:
    """Floor, light and cameras, as far from the fish as its length asks."""
    world = spec.worldbody
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
    spec.visual.headlight.ambient = [0.3, 0.3, 0.3]
    spec.visual.headlight.diffuse = [0.25, 0.25, 0.25]
    texture = spec.add_texture(name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    texture.rgb1, texture.rgb2 = [0.25, 0.52, 0.62], [0.31, 0.58, 0.68]
    texture.width = texture.height = 256
    material = spec.add_material(name="tiles", texrepeat=[200 / scale, 200 / scale])
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "tiles"
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[50, 50, 0.1],
        pos=[0, 0, -0.25 * scale],
        material="tiles",
        contype=0,
        conaffinity=0,
    )
    sun = world.add_light(pos=[0, 0, 3], dir=[0.3, 0.2, -1])
    sun.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    sun.diffuse = [0.6, 0.6, 0.6]
    head = spec.body("head")
    track = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    head.add_camera(name="above", mode=track, pos=[-0.15 * scale, 0, 1.1 * scale], fovy=45)
    place = [-0.17 * scale, -0.62 * scale, 0.42 * scale]
    head.add_camera(name="beside", mode=track, pos=place, xyaxes=[1, 0, 0, 0, 0.56, 0.83])
