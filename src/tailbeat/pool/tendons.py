"""The pair of tendons: lengths, and the forces that they put on motor and hinges; compiled.

A pulley winds r theta; a crank's arm moves its anchor in the vertical plane.
"""

import numpy as np

from tailbeat.pool.compiled import compiled
from tailbeat.pool.kinematics import add


@compiled
def tendon_lengths(q, chain, frames, lengths, rows):  # type: ignore[no-untyped-def]
    """Lengths (2,) [m] of left and right tendon and their Jacobians `rows` (2, nv)."""
    motor = chain.motor[0]
    rows[:] = 0.0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        guides = chain.guides[side]
        lengths[side] = 0.0
        if not motor.crank:
            lengths[side] = sign * motor.sign * motor.radius * q[3]
            rows[side, 3] = sign * motor.sign * motor.radius
        elif len(guides) > 0:
            lengths[side] = _arm(q, sign, motor, guides[0], frames, rows[side])
        for g in range(1, len(guides)):
            lengths[side] += _span(guides[g - 1], guides[g], frames, rows[side])


@compiled
def _span(first, second, frames, row):  # type: ignore[no-untyped-def]
    """Length from one guide to the next; 0 where both are on one body."""
    if first.body == second.body:
        return 0.0
    ax, ay = _world(frames[first.body], first.x, first.y)
    bx, by = _world(frames[second.body], second.x, second.y)
    span = np.hypot(bx - ax, by - ay)
    toward = ((bx - ax) / span, (by - ay) / span)
    _bend(first.body, second.body, (bx, by), toward, frames, row)
    return span


@compiled
def _arm(q, sign, motor, guide, frames, row):  # type: ignore[no-untyped-def]
    """Length from a crank's arm to the first guide."""
    radius, half = motor.radius, motor.half_width
    cos, sin = np.cos(q[3]), np.sin(q[3])
    x, y, z = motor.x + sign * radius * sin, sign * half, -sign * radius * cos
    p, b = frames[0], guide.body
    ax, ay = _world(p, x, y)
    bx, by = _world(frames[b], guide.x, guide.y)
    span = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + z * z)
    ahead = (p.cos * (bx - ax) + p.sin * (by - ay)) / span
    row[3] = -ahead * sign * radius * cos + z / span * sign * radius * sin
    _bend(0, b, (bx, by), ((bx - ax) / span, (by - ay) / span), frames, row)
    return span


@compiled
def _world(frame, x, y):  # type: ignore[no-untyped-def]
    return frame.x + frame.cos * x - frame.sin * y, frame.y + frame.sin * x + frame.cos * y


@compiled
def _bend(a, b, point, toward, frames, row):  # type: ignore[no-untyped-def]
    """What the hinges between bodies a and b do to the distance to a point of b."""
    for j in range(a + 1, b + 1):
        row[3 + j] += (point[1] - frames[j].y) * toward[0] - (point[0] - frames[j].x) * toward[1]


@compiled
def add_tendons(chain, work):  # type: ignore[no-untyped-def]
    """Tendon forces, and their stiffness and damping for the implicit step."""
    tendon, neutral, lengths = chain.tendon[0], chain.neutral, work.lengths
    tendon_lengths(work.q, chain, work.frames, lengths, work.pulls)
    if tendon.tied:
        stretch = (lengths[0] - neutral[0] - lengths[1] + neutral[1]) / 2
        if not (tendon.left_cut if stretch > 0 else tendon.right_cut):
            _pull_tied(tendon, stretch, work)
        return
    for side in range(2):
        stretch = lengths[side] - neutral[side]
        sign = -1.0 if tendon.two_way and stretch < 0 else 1.0  # a pair that pushes too
        stretch = sign * max(sign * stretch - tendon.slack, 0.0)
        cut = tendon.left_cut if side == 0 else tendon.right_cut
        if not cut and stretch != 0.0:
            work.row[:] = work.pulls[side]
            _pull(tendon.stiffness, tendon.damping, stretch, work)


@compiled
def _pull_tied(tendon, stretch, work):  # type: ignore[no-untyped-def]
    """Force of an inextensible pair, which pulls either way beyond its slack."""
    beyond = abs(stretch) - tendon.slack
    if tendon.slack > 0 and beyond <= 0:
        return
    work.row[:] = (work.pulls[0] - work.pulls[1]) / 2
    if tendon.slack > 0:
        stretch = np.sign(stretch) * beyond
    _pull(2 * tendon.stiffness, 2 * tendon.damping, stretch, work)


@compiled
def _pull(k, c, stretch, work):  # type: ignore[no-untyped-def]
    force, row = work.force, work.row
    force -= (k * stretch + c * (row @ work.v)) * row
    add(work.stiff, k, row)
    add(work.damp, c, row)
