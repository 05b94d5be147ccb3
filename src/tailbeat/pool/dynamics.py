"""One step of one fish in the pool's water, compiled: assemble, add the water, solve, move on.

The added mass is in the inertia (as a fed-back force, it diverges within 15 steps). Second order:
forces are taken at the middle of the step, predicted with the last acceleration a. Joints, tendons
and servo are linearly implicit about it, because the tendons are stiff:

    (M + M_A + dt/2 D + dt^2/4 K) qdd = forces(q + dt/2 qd, qd + dt/2 a) + dt/2 D a

Index names: b body, s strip, f fin, j hinge; dof 0-2 root, 3 motor, 3 + j hinge j.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tailbeat.pool.compiled import compiled
from tailbeat.pool.hydrodynamics import SEEN, add_water, shed
from tailbeat.pool.kinematics import FRAME, add, along, pose, turning
from tailbeat.pool.tendons import add_tendons

Array = NDArray[np.float64]
Rows = NDArray[np.void]
COULOMB = 0.02  # rad/s over which dry friction changes sign
STICKING = 0.002  # rad/s, the same in a hinge: a bent tail creeps back at this, times the hinges
WALL, WALL_DAMPING = 300.0, 20.0  # N/m, N s/m of a pool's wall against a point of the fish
LOCKED = 1e9  # kg, kg m^2: a held root

FADING = 60.0  # s, over which heat and a sagging supply weaken a servo; chosen

# A force [N] and torque [N m] on the head for a duration [s] from a time [s].
POKE = np.dtype([(name, float) for name in ("time", "duration", "x", "y", "torque")])
# A tether on the head: its pull x, y [N] in the world, its drag [N s^2/m^2].
TETHER = np.dtype([(name, float) for name in ("x", "y", "drag")])


class Moving(NamedTuple):
    """One fish's own arrays: q, v and last acceleration a (nv,), wakes of its fins (f,)."""

    q: Array
    v: Array
    a: Array
    wakes: Rows


class Around(NamedTuple):
    """Surroundings and servo of one fish, or of n fish with one row each.

    Rows `water` and `servo`; `modes` (m,) of the flow; `walls` (2,) [m], half the pool's length and
    width (0: none); `pokes` (k,); `held`: whether the head is held; row `tether`.
    """

    water: Rows
    servo: Rows
    modes: Rows
    walls: Array
    pokes: Rows
    held: NDArray[np.bool_]
    tether: Rows


class Work(NamedTuple):
    """Scratch of one fish: `q`, `v` at the middle of the step; the system `mass`, `stiff`, `damp`
    (nv, nv) and `force` (nv,); body `frames` (b,); tendon `lengths` (2,) and Jacobians `pulls`
    (2, nv); the flow `seen` (f,) by each fin; a Jacobian `row` (nv,)."""

    q: Array
    v: Array
    mass: Array
    stiff: Array
    damp: Array
    force: Array
    frames: Rows
    lengths: Array
    pulls: Array
    seen: Rows
    row: Array


@compiled
def add_bodies(chain, armature, work):  # type: ignore[no-untyped-def]
    """Rigid bodies and motor into `mass` (nv, nv) and, as bias, into `force` (nv,)."""
    mass, force, row, frames = work.mass, work.force, work.row, work.frames
    motor = chain.motor[0]
    for b in range(len(chain.bodies)):
        body = chain.bodies[b]
        _lump(b, body.centre, body.mass, frames, mass, force, row)
        turning(b, row)
        add(mass, body.inertia, row)
    _lump(0, motor.x, motor.mass, frames, mass, force, row)
    turning(0, row)
    if motor.crank:
        mass[3, 3] += motor.inertia
        add(mass, motor.inertia, row)
    else:  # a pulley's rotor turns about the same axis, the other way
        row[3] = -1.0
        add(mass, motor.inertia, row)
    mass[3, 3] += armature


@compiled
def _lump(b, x, weight, frames, mass, force, row):  # type: ignore[no-untyped-def]
    """A point mass at x along body b."""
    p = frames[b]
    px, py = p.x + p.cos * x, p.y + p.sin * x
    square = p.spin * p.spin
    along(b, px, py, 1.0, 0.0, frames, row)
    add(mass, weight, row)
    force -= weight * (p.ax - square * p.cos * x) * row
    along(b, px, py, 0.0, 1.0, frames, row)
    add(mass, weight, row)
    force -= weight * (p.ay - square * p.sin * x) * row


@compiled
def add_drive(command, chain, servo, strength, work):  # type: ignore[no-untyped-def]
    """Hinge springs and the servo, at the middle of a step as it is predicted."""
    q, v, force, stiff, damp = work.q, work.v, work.force, work.stiff, work.damp
    for j in range(len(chain.hinges)):
        hinge = chain.hinges[j]
        loss = hinge.damping
        if hinge.dry > 0:
            loss += hinge.dry / np.sqrt(v[4 + j] * v[4 + j] + STICKING * STICKING)
        force[4 + j] -= hinge.stiffness * (q[4 + j] - hinge.rest) + loss * v[4 + j]
        stiff[4 + j, 4 + j] += hinge.stiffness
        damp[4 + j, 4 + j] += loss
    torque = actuator(command, q[3], v[3], servo, strength)
    if abs(torque) < strength * servo.force_limit:
        stiff[3, 3] += strength * servo.kp
        damp[3, 3] += strength * servo.kv
    dry = servo.friction / np.sqrt(v[3] * v[3] + COULOMB * COULOMB)
    force[3] += torque - (servo.damping + dry) * v[3]
    damp[3, 3] += servo.damping + dry


@compiled
def fading(time, fade):  # type: ignore[no-untyped-def]
    """What is left of a servo's gain and torque at a time [s], as a fraction: 1 - `fade` in the
    end."""
    return 1.0 - fade * (1.0 - np.exp(-time / FADING)) if fade > 0 else 1.0


@compiled
def actuator(command, angle, speed, servo, strength):  # type: ignore[no-untyped-def]
    """The servo's torque [N m], within its limit, without friction and damping of its shaft."""
    wanted = strength * (servo.kp * (command - angle) - servo.kv * speed)
    limit = strength * servo.force_limit
    return min(max(wanted, -limit), limit)


@compiled
def add_walls(chain, walls, work):  # type: ignore[no-untyped-def]
    """Stiff walls at x = +-walls[0], y = +-walls[1] against nose and fin; none where 0."""
    force, row = work.force, work.row
    for b, x in ((0, chain.nose), (len(chain.bodies) - 1, chain.rear)):
        p = work.frames[b]
        px, py = p.x + p.cos * x, p.y + p.sin * x
        vx, vy = p.vx - p.spin * p.sin * x, p.vy + p.spin * p.cos * x
        for axis, at, speed in ((0, px, vx), (1, py, vy)):
            deep = abs(at) - walls[axis]
            if walls[axis] > 0 and deep > 0:
                out = np.sign(at)
                push = max(WALL * deep + WALL_DAMPING * speed * out, 0.0)
                along(b, px, py, 1.0 - axis, 1.0 * axis, work.frames, row)
                force -= push * out * row


@compiled
def add_pokes(x, pokes, time, work):  # type: ignore[no-untyped-def]
    """The forces and torques in force at `time` on the head, at x."""
    fx, fy, torque = 0.0, 0.0, 0.0
    for poke in pokes:
        if poke.time <= time < poke.time + poke.duration:
            fx, fy, torque = fx + poke.x, fy + poke.y, torque + poke.torque
    if fx != 0 or fy != 0 or torque != 0:
        p, force = work.frames[0], work.force
        along(0, p.x + p.cos * x, p.y + p.sin * x, fx, fy, work.frames, work.row)
        force += work.row
        force[2] += torque


@compiled
def add_tether(x, tether, work):  # type: ignore[no-untyped-def]
    """A tether's pull and drag on the head, at x."""
    if tether.x == 0 and tether.y == 0 and tether.drag == 0:
        return
    p, force = work.frames[0], work.force
    vx, vy = p.vx - p.spin * p.sin * x, p.vy + p.spin * p.cos * x
    drag = tether.drag * np.hypot(vx, vy)
    fx, fy = tether.x - drag * vx, tether.y - drag * vy
    along(0, p.x + p.cos * x, p.y + p.sin * x, fx, fy, work.frames, work.row)
    force += work.row


@compiled
def solve(matrix, rhs):  # type: ignore[no-untyped-def]
    """Cholesky solution of a symmetric positive system, in place."""
    n = len(rhs)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]
    for i in range(n):
        for k in range(i):
            rhs[i] -= matrix[i, k] * rhs[k]
        rhs[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            rhs[i] -= matrix[k, i] * rhs[k]
        rhs[i] /= matrix[i, i]


@compiled
def step(fish, command, time, dt, chain, around, work):  # type: ignore[no-untyped-def]
    """One step of one fish from `time`, in place; returns the actuator's mean torque [N m].

    The torque is that of the motion found. The predicted one would show an inertia of kp dt^2 / 4
    too many on a torque sensor.
    `fish` is a `Moving`, `chain` a `Chain`, `around` an `Around`, `work` a `Work`.
    """
    mass, stiff, damp, force = work.mass, work.stiff, work.damp, work.force
    mass[:], stiff[:], damp[:], force[:] = 0.0, 0.0, 0.0, 0.0
    work.q[:] = fish.q + dt / 2 * fish.v
    work.v[:] = fish.v + dt / 2 * fish.a
    pose(work.q, work.v, chain.bodies, work.frames)
    add_bodies(chain, around.servo.armature, work)
    add_water(chain, around, time + dt / 2, dt / 2, fish.wakes, work)
    add_tendons(chain, work)
    strength = fading(time, around.servo.fade)
    add_drive(command, chain, around.servo, strength, work)
    add_walls(chain, around.walls, work)
    add_pokes(chain.bodies[0].centre, around.pokes, time, work)
    add_tether(chain.bodies[0].centre, around.tether, work)
    if around.held:
        for i in range(3):
            mass[i, i] += LOCKED
    force += dt / 2 * (damp @ fish.a)
    mass += dt / 2 * damp + dt * dt / 4 * stiff
    solve(mass, force)
    angle = work.q[3] + dt * dt / 4 * force[3]
    torque = actuator(command, angle, fish.v[3] + dt / 2 * force[3], around.servo, strength)
    _move(fish, force, dt)
    shed(chain, around, dt / 2, fish.wakes, work)
    return torque


@compiled
def _move(fish, acceleration, dt):  # type: ignore[no-untyped-def]
    """Joints one step on under a constant acceleration (nv,)."""
    q, v = fish.q, fish.v
    q += dt * v + dt * dt / 2 * acceleration
    v += dt * acceleration
    fish.a[:] = acceleration


@compiled
def scratch(dofs, bodies, fins):  # type: ignore[no-untyped-def]
    """A `Work` of so many degrees of freedom, bodies and fins."""
    return Work(
        np.empty(dofs),
        np.empty(dofs),
        np.empty((dofs, dofs)),
        np.empty((dofs, dofs)),
        np.empty((dofs, dofs)),
        np.empty(dofs),
        np.empty(bodies, FRAME),
        np.empty(2),
        np.empty((2, dofs)),
        np.empty(fins, SEEN),
        np.empty(dofs),
    )
