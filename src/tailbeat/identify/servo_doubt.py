"""How sure is a servo's fit? Correlated residuals, the load's doubt, what the fit leaves out."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.search import Fit
from tailbeat.identify.servo import DEVIATION, STEP
from tailbeat.identify.shaft import Bench
from tailbeat.identify.space import Edges, Parameter, sensitivity, values

Array = NDArray[np.float64]
HINGES = 1e-4  # s, deviation of the delay: up to 0.15 ms with noise-free fish of 0.28 to 1 m
# Uncertainty of the load: 1 %, chosen. A free run gives the servo's torques only in proportion to
# the load's, so each of them has this uncertainty.
LOAD_DOUBT = 0.01
IN_PROPORTION = "gain_scale kp kv armature damping damping_off friction force_limit".split()


def with_honest_intervals(
    fit: Fit,
    residuals: Callable[[Array], Array],
    groups: NDArray[np.int_],
    edges: Edges | None = None,
    prior: Array | None = None,
) -> Fit:
    """The fit with a covariance that allows for correlated residuals and an inexact model.

    Sandwich estimate over blocks of time (White 1982; Liang and Zeger 1986); the prior counts as
    one more observation, whose error has the covariance `prior` (p, p) in z, else 1. So the fifty
    samples of one standstill count as one observation.
    """
    found, slope = sensitivity(residuals, fit.z, step=STEP, edges=edges)
    bread = np.linalg.inv(slope.T @ slope + np.eye(fit.z.size))
    gradients = np.zeros((groups.max() + 1, fit.z.size))
    np.add.at(gradients, groups, slope * found[:, None])
    many = len(gradients)
    meat = gradients.T @ gradients * many / max(many - fit.z.size, 1)
    meat += np.eye(fit.z.size) if prior is None else prior
    covariance = bread @ meat @ bread
    return replace(fit, residuals=found, jacobian=slope, covariance=covariance)


def delay_doubt(space: tuple[Parameter, ...]) -> Array:
    """Covariance (p, p) in z of the delay, because a tail of several hinges has more than one
    degree of freedom."""
    return np.diag([(HINGES / p.spread if p.path == "delay" else 0.0) ** 2 for p in space])


def load_doubt(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> Array:
    """Covariance (p, p) in z of the torques' common scale, which only the load gives.

    The load itself is uncertain. And it shows in how far the servo gives way under it: an angle
    that errs by `DEVIATION` everywhere is a large share of the sag of a soft tail.
    """
    shift = np.zeros(z.size)
    sags = [sag for bench in benches if (sag := _sag(space, z, bench)) > 0]
    if not sags:
        return np.diag(shift)
    for i, p in enumerate(space):
        if p.path in IN_PROPORTION:
            shift[i] = 1.0 / p.spread if p.log else p.from_z(float(z[i])) / p.spread
    return (LOAD_DOUBT**2 + (DEVIATION / max(sags)) ** 2) * np.outer(shift, shift)


def _sag(space: tuple[Parameter, ...], z: Array, bench: Bench) -> float:
    """Angle [rad] by which the servo gives way under its load at the largest angle; 0 without a
    load."""
    found = values(space, z)
    kp = found["kp"] if "kp" in found else found["gain_scale"] * (bench.gain or 0.0)
    load, widest = bench.load, float(np.nanmax(np.abs(bench.angle)))
    torque = load.stiffness * widest + load.weight * np.sin(min(widest, np.pi / 2))
    return float(torque / kp) if kp > 0 else 0.0
