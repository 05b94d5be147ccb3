"""One step of one fish in the pool's water, compiled: assemble, add the water, solve, move on.

The added mass is in the inertia (fed back as a force it blows up within 15 steps). Second order:
forces at the middle of the step, predicted with the last acceleration a; joints, tendons and servo
linearly implicit about it, for the tendons are stiff:

    (M + M_A + dt/2 D + dt^2/4 K) qdd = forces(q + dt/2 qd, qd + dt/2 a) + dt/2 D a

 Strip equations: Kirchhoff's for a slender section, with the centre's velocity
(u, w) relative to the water, m_n across and m_t along:

    F_n = -m_n wdot - m_t omega u,  F_t = -m_t udot + m_n omega w
    M = -I omegadot - (m_n - m_t) u w
    wdot = N qdd + a_n - omega u,   udot = T qdd + a_t + omega w

(Lighthill's large-amplitude elongated body without a trailing edge: the fin sheds the wake.)
Index names: b body, s strip, f fin, j hinge; dof 0-2 root, 3 motor, 3 + j hinge j.
"""

import numpy as np
from numba import njit

from tailbeat.pool.section import advance, section

COULOMB = 0.02  # rad/s over which dry friction turns round
WALL, WALL_DAMPING = 300.0, 20.0  # N/m, N s/m of a pool's wall against a point of the fish
LOCKED = 1e9  # kg, kg m^2: a held root


@njit(cache=True)
def pose(q, v, origin, place, spin):  # type: ignore[no-untyped-def]
    """Bodies from joints: `place` (b, 8) x, y, cos, sin, vx, vy, and the acceleration ax, ay that
    remains at qdd = 0; `spin` (b,) yaw rates."""
    angle = q[2]
    place[0, 0], place[0, 1], place[0, 4], place[0, 5] = q[0], q[1], v[0], v[1]
    place[0, 6], place[0, 7], spin[0] = 0.0, 0.0, v[2]
    place[0, 2], place[0, 3] = np.cos(angle), np.sin(angle)
    for b in range(1, len(origin)):
        p, rate = place[b - 1], spin[b - 1]
        dx, dy = p[2] * origin[b], p[3] * origin[b]
        place[b, 0], place[b, 1] = p[0] + dx, p[1] + dy
        place[b, 4], place[b, 5] = p[4] - rate * dy, p[5] + rate * dx
        place[b, 6], place[b, 7] = p[6] - rate * rate * dx, p[7] - rate * rate * dy
        angle -= q[3 + b]
        spin[b] = rate - v[3 + b]
        place[b, 2], place[b, 3] = np.cos(angle), np.sin(angle)


@njit(cache=True)
def along(b, x, y, dx, dy, place, row):  # type: ignore[no-untyped-def]
    """Row of the Jacobian of a point (x, y) of body b in the direction (dx, dy)."""
    row[:] = 0.0
    row[0], row[1] = dx, dy
    row[2] = (x - place[0, 0]) * dy - (y - place[0, 1]) * dx
    for j in range(1, b + 1):
        row[3 + j] = (y - place[j, 1]) * dx - (x - place[j, 0]) * dy


@njit(cache=True)
def turning(b, row):  # type: ignore[no-untyped-def]
    """Row of the Jacobian of body b's yaw rate."""
    row[:] = 0.0
    row[2] = 1.0
    row[4 : 4 + b] = -1.0


@njit(cache=True)
def add(matrix, scale, row):  # type: ignore[no-untyped-def]
    """matrix += scale * row row'."""
    for i in range(len(row)):
        if row[i] != 0.0:
            matrix[i] += scale * row[i] * row


@njit(cache=True)
def bodies(chain, armature, place, spin, mass, force, row):  # type: ignore[no-untyped-def]
    """Rigid bodies and motor into `mass` (nv, nv) and, as bias, into `force` (nv,)."""
    origin, weights, centre, inertia, motor = chain[0], chain[1], chain[2], chain[3], chain[12]
    for b in range(len(origin)):
        _lump(b, centre[b], weights[b], place, spin, mass, force, row)
        turning(b, row)
        add(mass, inertia[b], row)
    _lump(0, motor[1], motor[6], place, spin, mass, force, row)
    turning(0, row)
    if motor[0] == 0.0:  # a pulley's rotor turns about the same axis, the other way
        row[3] = -1.0
        add(mass, motor[5], row)
    else:
        mass[3, 3] += motor[5]
        add(mass, motor[5], row)
    mass[3, 3] += armature


@njit(cache=True)
def _lump(b, x, weight, place, spin, mass, force, row):  # type: ignore[no-untyped-def]
    """A point mass at x along body b."""
    p = place[b]
    px, py = p[0] + p[2] * x, p[1] + p[3] * x
    square = spin[b] * spin[b]
    along(b, px, py, 1.0, 0.0, place, row)
    add(mass, weight, row)
    force -= weight * (p[6] - square * p[2] * x) * row
    along(b, px, py, 0.0, 1.0, place, row)
    add(mass, weight, row)
    force -= weight * (p[7] - square * p[3] * x) * row


@njit(cache=True)
def current(x, y, time, modes):  # type: ignore[no-untyped-def]
    """Background flow [m/s]: curls of plane waves, so free of divergence; modes (m, 5) are size
    [m/s], kx, ky [rad/m], rate [rad/s], phase."""
    ux, uy = 0.0, 0.0
    for mode in modes:
        wave = mode[0] * np.cos(mode[1] * x + mode[2] * y + mode[3] * time + mode[4])
        scale = 1 / np.sqrt(mode[1] ** 2 + mode[2] ** 2)
        ux += wave * mode[2] * scale
        uy -= wave * mode[1] * scale
    return ux, uy


@njit(cache=True)
def water(chain, p, time, half, modes, place, spin, state, mass, force, row, seen):  # type: ignore[no-untyped-def]
    """Strips and fins: added mass into `mass`, everything else into `force`.

    A fin's state moves on by `half` a step [s] before its forces are taken, at the middle; `seen`
    (f, 3) takes its u, w, omega for the other half.
    """
    strip_body, strips, fin_body, fins, factors = chain[4], chain[5], chain[6], chain[7], chain[13]
    density, scale = p[0], p[8] * p[17]
    for s in range(len(strip_body)):
        b, length, height = strip_body[s], strips[s, 1], strips[s, 2]
        u, w, a_t, a_n, x, y = _relative(b, strips[s, 0], time, modes, place, spin)
        across = density * np.pi * height**2 / 4 * length * scale
        flow = p[7] * across
        inertia = across * length**2 / 12
        rate = spin[b]
        skin = -0.5 * density * p[5] * 2.2 * height * length * abs(u) * u
        drag = -0.5 * density * p[6] * height * length * abs(w) * w
        f_n = -across * a_n + (across - flow) * rate * u + drag
        f_t = -flow * a_t + (across - flow) * rate * w + skin
        moment = -(across - flow) * u * w
        _spread(b, x, y, f_t, f_n, moment, flow, across, inertia, place, mass, force, row)
    for f in range(len(fin_body)):
        b, chord, height = fin_body[f], fins[f, 1], fins[f, 2]
        u, w, _, a_n, x, y = _relative(b, fins[f, 0], time, modes, place, spin)
        rate = spin[b]
        across = density * np.pi * chord**2 / 4 * height * factors[f, 1] * scale
        inertia = density * np.pi * chord**4 / 128 * height * factors[f, 2] * scale
        advance(u, w, rate, state[f], chord, half, p)
        normal, forward, moment = section(u, w, rate, state[f], chord, height, factors[f, 0], p)
        f_n = normal - across * (a_n - rate * u)
        moment -= across * u * chord / 4 * rate
        _spread(b, x, y, forward, f_n, moment, 0.0, across, inertia, place, mass, force, row)
        seen[f, 0], seen[f, 1], seen[f, 2] = u, w, rate


@njit(cache=True)
def _relative(b, x, time, modes, place, spin):  # type: ignore[no-untyped-def]
    """Velocity along t and n relative to the water, bias acceleration along both, world place."""
    p, rate = place[b], spin[b]
    dx, dy = p[2] * x, p[3] * x
    px, py = p[0] + dx, p[1] + dy
    ux, uy = current(px, py, time, modes)
    vx, vy = p[4] - rate * dy - ux, p[5] + rate * dx - uy
    ax, ay = p[6] - rate * rate * dx, p[7] - rate * rate * dy
    return (
        p[2] * vx + p[3] * vy,
        p[2] * vy - p[3] * vx,
        p[2] * ax + p[3] * ay,
        p[2] * ay - p[3] * ax,
        px,
        py,
    )


@njit(cache=True)
def _spread(b, x, y, f_t, f_n, moment, m_t, m_n, inertia, place, mass, force, row):  # type: ignore[no-untyped-def]
    """Forces on a point of body b and its added mass, into the joints' space."""
    cos, sin = place[b, 2], place[b, 3]
    along(b, x, y, cos, sin, place, row)
    force += f_t * row
    if m_t > 0:
        add(mass, m_t, row)
    along(b, x, y, -sin, cos, place, row)
    force += f_n * row
    if m_n > 0:
        add(mass, m_n, row)
    turning(b, row)
    force += moment * row
    if inertia > 0:
        add(mass, inertia, row)


@njit(cache=True)
def tendon_lengths(q, chain, place, lengths, rows):  # type: ignore[no-untyped-def]
    """Lengths (2,) [m] of left and right tendon and their Jacobians (2, nv).

    A pulley winds r theta; a crank's arm moves its anchor in the vertical plane.
    """
    guide_body, guide, motor = chain[10], chain[11], chain[12]
    rows[:] = 0.0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        lengths[side] = 0.0
        if motor[0] == 0.0:
            lengths[side] = sign * motor[4] * motor[2] * q[3]
            rows[side, 3] = sign * motor[4] * motor[2]
        elif len(guide_body) > 0:
            lengths[side] = _arm(q, sign, side, chain, place, rows[side])
        for g in range(1, len(guide_body)):
            a, b = guide_body[g - 1], guide_body[g]
            if a == b:
                continue
            ax, ay = _world(place[a], guide[side, g - 1])
            bx, by = _world(place[b], guide[side, g])
            span = np.hypot(bx - ax, by - ay)
            lengths[side] += span
            _bend(a, b, bx, by, (bx - ax) / span, (by - ay) / span, place, rows[side])


@njit(cache=True)
def _arm(q, sign, side, chain, place, row):  # type: ignore[no-untyped-def]
    """Length from a crank's arm to the first guide."""
    guide_body, guide, motor = chain[10], chain[11], chain[12]
    radius, half = motor[2], motor[3]
    cos, sin = np.cos(q[3]), np.sin(q[3])
    x, y, z = motor[1] + sign * radius * sin, sign * half, -sign * radius * cos
    p, b = place[0], guide_body[0]
    ax, ay = p[0] + p[2] * x - p[3] * y, p[1] + p[3] * x + p[2] * y
    bx, by = _world(place[b], guide[side, 0])
    span = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + z * z)
    ahead = (p[2] * (bx - ax) + p[3] * (by - ay)) / span
    row[3] = -ahead * sign * radius * cos + z / span * sign * radius * sin
    _bend(0, b, bx, by, (bx - ax) / span, (by - ay) / span, place, row)
    return span


@njit(cache=True)
def _world(p, point):  # type: ignore[no-untyped-def]
    return p[0] + p[2] * point[0] - p[3] * point[1], p[1] + p[3] * point[0] + p[2] * point[1]


@njit(cache=True)
def _bend(a, b, x, y, dx, dy, place, row):  # type: ignore[no-untyped-def]
    """What the hinges between bodies a and b do to the distance to a point of b."""
    for j in range(a + 1, b + 1):
        row[3 + j] += (y - place[j, 1]) * dx - (x - place[j, 0]) * dy


@njit(cache=True)
def tendons(q, v, chain, place, lengths, rows, force, stiff, damp, row):  # type: ignore[no-untyped-def]
    """Tendon forces, and their stiffness and damping for the implicit step."""
    motor_tendon, neutral = chain[14], chain[15]
    k, c, slack, two_way, tied = motor_tendon
    tendon_lengths(q, chain, place, lengths, rows)
    if tied > 0:
        row[:] = (rows[0] - rows[1]) / 2
        stretch = (lengths[0] - neutral[0] - lengths[1] + neutral[1]) / 2
        _pull(2 * k, 2 * c, stretch, v, row, force, stiff, damp)
        return
    for side in range(2):
        stretch = lengths[side] - neutral[side] - slack
        if stretch > 0 or two_way > 0:
            row[:] = rows[side]
            _pull(k, c, stretch, v, row, force, stiff, damp)


@njit(cache=True)
def _pull(k, c, stretch, v, row, force, stiff, damp):  # type: ignore[no-untyped-def]
    force -= (k * stretch + c * (row @ v)) * row
    add(stiff, k, row)
    add(damp, c, row)


@njit(cache=True)
def drive(q, v, command, servo, chain, force, stiff, damp):  # type: ignore[no-untyped-def]
    """Hinge springs and the servo; returns the actuator's torque [N m]."""
    stiffness, damping = chain[8], chain[9]
    for j in range(len(stiffness)):
        force[4 + j] -= stiffness[j] * q[4 + j] + damping[j] * v[4 + j]
        stiff[4 + j, 4 + j] += stiffness[j]
        damp[4 + j, 4 + j] += damping[j]
    kp, kv, limit = servo[0], servo[1], servo[5]
    wanted = kp * (command - q[3]) - kv * v[3]
    torque = min(max(wanted, -limit), limit)
    if torque == wanted:
        stiff[3, 3] += kp
        damp[3, 3] += kv
    dry = servo[4] / np.sqrt(v[3] * v[3] + COULOMB * COULOMB)
    force[3] += torque - (servo[3] + dry) * v[3]
    damp[3, 3] += servo[3] + dry
    return torque


@njit(cache=True)
def walls(chain, half, place, spin, force, row):  # type: ignore[no-untyped-def]
    """Stiff walls at x = +-half[0], y = +-half[1] against nose and fin; none where half is 0."""
    for b, x in ((0, chain[16][0]), (len(chain[0]) - 1, chain[16][1])):
        p = place[b]
        px, py = p[0] + p[2] * x, p[1] + p[3] * x
        vx, vy = p[4] - spin[b] * p[3] * x, p[5] + spin[b] * p[2] * x
        for axis, at, speed in ((0, px, vx), (1, py, vy)):
            deep = abs(at) - half[axis]
            if half[axis] > 0 and deep > 0:
                out = np.sign(at)
                push = max(WALL * deep + WALL_DAMPING * speed * out, 0.0)
                along(b, px, py, 1.0 - axis, 1.0 * axis, place, row)
                force -= push * out * row


@njit(cache=True)
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


@njit(cache=True)
def step(q, v, a, state, command, time, dt, chain, p, servo, modes, half, poke, held, work):  # type: ignore[no-untyped-def]
    """One step of one fish, in place; returns the actuator's torque.

    `a` (nv,) is the last acceleration, `state` (f, 6) the fins'; `poke` (3,) force [N] and torque
    [N m] on the head at its centre of mass; `held` locks the root; `work` is scratch.
    """
    mass, stiff, damp, force, row, place, spin, lengths, rows, seen, middle, speed = work
    mass[:], stiff[:], damp[:], force[:] = 0.0, 0.0, 0.0, 0.0
    middle[:] = q + dt / 2 * v
    speed[:] = v + dt / 2 * a
    pose(middle, speed, chain[0], place, spin)
    bodies(chain, servo[2], place, spin, mass, force, row)
    now = time + dt / 2
    water(chain, p, now, dt / 2, modes, place, spin, state, mass, force, row, seen)
    tendons(middle, speed, chain, place, lengths, rows, force, stiff, damp, row)
    torque = drive(middle, speed, command, servo, chain, force, stiff, damp)
    walls(chain, half, place, spin, force, row)
    if poke[0] != 0 or poke[1] != 0 or poke[2] != 0:
        push(chain[2][0], poke, place, force, row)
    if held:
        for i in range(3):
            mass[i, i] += LOCKED
    force += dt / 2 * (damp @ a)
    mass += dt / 2 * damp + dt * dt / 4 * stiff
    solve(mass, force)
    q += dt * v + dt * dt / 2 * force
    v += dt * force
    a[:] = force
    for f in range(len(state)):
        advance(seen[f, 0], seen[f, 1], seen[f, 2], state[f], chain[7][f, 1], dt / 2, p)
    return torque


@njit(cache=True)
def push(x, poke, place, force, row):  # type: ignore[no-untyped-def]
    """A force and a torque on the head at x."""
    px, py = place[0, 0] + place[0, 2] * x, place[0, 1] + place[0, 3] * x
    along(0, px, py, poke[0], poke[1], place, row)
    force += row
    force[2] += poke[2]
