"""The water on a fish: slender strips with added mass and drag, fins with circulation; compiled.

Strip equations: Kirchhoff's for a slender section, with the centre's velocity
(u, w) relative to the water, m_n across and m_t along:

    F_n = -m_n wdot - m_t omega u,  F_t = -m_t udot + m_n omega w
    M = -I omegadot - (m_n - m_t) u w
    wdot = N qdd + a_n - omega u,   udot = T qdd + a_t + omega w

(Lighthill's large-amplitude elongated body without a trailing edge: the fin sheds the wake.)
"""

from typing import NamedTuple

import numpy as np

from tailbeat.pool.compiled import compiled
from tailbeat.pool.kinematics import add, along, turning
from tailbeat.pool.section import Flow, advance, section

# A wave of the background flow: speed [m/s], wave numbers [rad/m], rate [rad/s], phase [rad].
MODE = np.dtype([(name, float) for name in ("speed", "kx", "ky", "rate", "phase")])
# The flow by a fin.
SEEN = np.dtype([(name, float) for name in Flow._fields])


class Motion(NamedTuple):
    """A point of body `body` in the world [m], its flow, its acceleration at qdd = 0 [m/s^2]."""

    body: int
    x: float
    y: float
    flow: Flow
    a_t: float
    a_n: float


class Load(NamedTuple):
    """Forces along t and n [N] and moment [N m]; added masses [kg] and inertia [kg m^2]."""

    along: float
    across: float
    moment: float
    mass_along: float
    mass_across: float
    inertia: float


@compiled
def current(x, y, time, modes):  # type: ignore[no-untyped-def]
    """Background flow [m/s]: curls of plane waves, so free of divergence; see `MODE`."""
    ux, uy = 0.0, 0.0
    for mode in modes:
        wave = mode.speed * np.cos(mode.kx * x + mode.ky * y + mode.rate * time + mode.phase)
        scale = 1 / np.sqrt(mode.kx**2 + mode.ky**2)
        ux += wave * mode.ky * scale
        uy -= wave * mode.kx * scale
    return ux, uy


@compiled
def add_water(chain, around, time, half, wakes, work):  # type: ignore[no-untyped-def]
    """Strips and fins: added mass into `mass`, everything else into `force`.

    A fin's wake moves on by `half` a step [s] before its forces are taken, at the middle; `seen`
    takes its flow for the other half (`shed`).
    """
    mass, force, row, frames = work.mass, work.force, work.row, work.frames
    water, modes = around.water, around.modes
    for strip in chain.strips:
        motion = _motion(strip.body, strip.x, time, modes, frames)
        _spread(motion, _strip_load(strip, motion, water), frames, mass, force, row)
    for f in range(len(chain.fins)):
        fin, seen = chain.fins[f], work.seen[f]
        motion = _motion(fin.body, fin.x, time, modes, frames)
        seen.u, seen.w, seen.omega = motion.flow
        advance(motion.flow, wakes[f], fin.chord, half, water)
        load = _fin_load(fin, motion, wakes[f], water)
        _spread(motion, load, frames, mass, force, row)


@compiled
def _strip_load(strip, motion, water):  # type: ignore[no-untyped-def]
    """Kirchhoff's forces on a slice of a body, its skin friction and cross-flow drag."""
    length, height = strip.length, strip.height
    u, w, rate = motion.flow.u, motion.flow.w, motion.flow.omega
    scale = water.added_mass * water.with_added_inertia
    across = water.density * np.pi * height**2 / 4 * length * scale
    flow = water.along * across
    inertia = across * length**2 / 12
    skin = -0.5 * water.density * water.body_friction * 2.2 * height * length * abs(u) * u
    drag = -0.5 * water.density * water.body_drag * height * length * abs(w) * w
    f_n = -across * motion.a_n + (across - flow) * rate * u + drag
    f_t = -flow * motion.a_t + (across - flow) * rate * w + skin
    moment = -(across - flow) * u * w
    return Load(f_t, f_n, moment, flow, across, inertia)


@compiled
def _fin_load(fin, motion, wake, water):  # type: ignore[no-untyped-def]
    """The section's forces with its wake, and the fin's added mass."""
    chord, height = fin.chord, fin.height
    u, rate = motion.flow.u, motion.flow.omega
    scale = water.added_mass * water.with_added_inertia
    across = water.density * np.pi * chord**2 / 4 * height * fin.heave * scale
    inertia = water.density * np.pi * chord**4 / 128 * height * fin.pitch * scale
    normal, forward, moment = section(motion.flow, wake, fin, water)
    f_n = normal - across * (motion.a_n - rate * u)
    moment -= across * u * chord / 4 * rate
    return Load(forward, f_n, moment, 0.0, across, inertia)


@compiled
def shed(chain, around, half, wakes, work):  # type: ignore[no-untyped-def]
    """The other half of a step [s] for every wake, in the flow that `add_water` saw."""
    for f in range(len(wakes)):
        seen = work.seen[f]
        flow = Flow(seen.u, seen.w, seen.omega)
        advance(flow, wakes[f], chain.fins[f].chord, half, around.water)


@compiled
def _motion(b, x, time, modes, frames):  # type: ignore[no-untyped-def]
    """The motion of a point at x along body b."""
    p = frames[b]
    dx, dy = p.cos * x, p.sin * x
    px, py = p.x + dx, p.y + dy
    ux, uy = current(px, py, time, modes)
    vx, vy = p.vx - p.spin * dy - ux, p.vy + p.spin * dx - uy
    ax, ay = p.ax - p.spin * p.spin * dx, p.ay - p.spin * p.spin * dy
    flow = Flow(p.cos * vx + p.sin * vy, p.cos * vy - p.sin * vx, p.spin)
    return Motion(b, px, py, flow, p.cos * ax + p.sin * ay, p.cos * ay - p.sin * ax)


@compiled
def _spread(motion, load, frames, mass, force, row):  # type: ignore[no-untyped-def]
    """Forces on a point and its added mass, into the joints' space."""
    b, x, y = motion.body, motion.x, motion.y
    cos, sin = frames[b].cos, frames[b].sin
    along(b, x, y, cos, sin, frames, row)
    force += load.along * row
    if load.mass_along > 0:
        add(mass, load.mass_along, row)
    along(b, x, y, -sin, cos, frames, row)
    force += load.across * row
    if load.mass_across > 0:
        add(mass, load.mass_across, row)
    turning(b, row)
    force += load.moment * row
    if load.inertia > 0:
        add(mass, load.inertia, row)
