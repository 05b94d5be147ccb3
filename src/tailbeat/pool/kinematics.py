"""Where each body is and how it moves, and what a point's force does to the joints; compiled.

The planar tree: root x, y, yaw (dof 0-2), motor (dof 3), one hinge per link (dof 3 + j).
"""

import numpy as np

from tailbeat.pool.compiled import compiled

# A body's frame: place of its origin [m], direction towards the nose, velocity [m/s], the
# acceleration [m/s^2] that remains at qdd = 0, and yaw rate [rad/s].
FRAME = np.dtype(
    [(name, float) for name in ("x", "y", "cos", "sin", "vx", "vy", "ax", "ay", "spin")]
)


@compiled
def pose(q, v, bodies, frames):  # type: ignore[no-untyped-def]
    """Frames (b,) of the bodies from joint angles and rates (nv,)."""
    angle = q[2]
    head = frames[0]
    head.x, head.y, head.vx, head.vy = q[0], q[1], v[0], v[1]
    head.ax, head.ay, head.spin = 0.0, 0.0, v[2]
    head.cos, head.sin = np.cos(angle), np.sin(angle)
    for b in range(1, len(bodies)):
        p, own = frames[b - 1], frames[b]
        dx, dy = p.cos * bodies[b].origin, p.sin * bodies[b].origin
        own.x, own.y = p.x + dx, p.y + dy
        own.vx, own.vy = p.vx - p.spin * dy, p.vy + p.spin * dx
        own.ax, own.ay = p.ax - p.spin * p.spin * dx, p.ay - p.spin * p.spin * dy
        angle -= q[3 + b]
        own.spin = p.spin - v[3 + b]
        own.cos, own.sin = np.cos(angle), np.sin(angle)


@compiled
def along(b, x, y, dx, dy, frames, row):  # type: ignore[no-untyped-def]
    """Row of the Jacobian of a point (x, y) of body b in the direction (dx, dy)."""
    row[:] = 0.0
    row[0], row[1] = dx, dy
    row[2] = (x - frames[0].x) * dy - (y - frames[0].y) * dx
    for j in range(1, b + 1):
        row[3 + j] = (y - frames[j].y) * dx - (x - frames[j].x) * dy


@compiled
def turning(b, row):  # type: ignore[no-untyped-def]
    """Row of the Jacobian of body b's yaw rate."""
    row[:] = 0.0
    row[2] = 1.0
    row[4 : 4 + b] = -1.0


@compiled
def add(matrix, scale, row):  # type: ignore[no-untyped-def]
    """matrix += scale * row row'."""
    for i in range(len(row)):
        if row[i] != 0.0:
            matrix[i] += scale * row[i] * row
