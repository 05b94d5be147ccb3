"""Figures of tail and servo from the test bench. Draws what others computed; computes nothing."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.files import new_file
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.servo_job import Overlay, ServoFit
from tailbeat.identify.tail import TailFit
from tailbeat.identify.tail_report import TailResult
from tailbeat.recording import Recording
from tailbeat.report.style import COMMAND, IDEALISED, MEASURED, ORANGE, TWIN, styled

# What a ring-down is read from, as an axis names it.
QUANTITIES = {"angle_rad": "angle [rad]", "torque_nm": "torque [N m]", "y_m": "tip sideways [m]"}


@styled
def tail(found: TailResult, static: Recording | None, path: Path, overwrite: bool = False) -> None:
    """Re H on the squared frequency, Im H with its two parts, and loop or ring-down if recorded."""
    extra = [static is not None, found.ring is not None]
    figure = Figure(figsize=(4.4 * (2 + sum(extra)), 3.8), layout="constrained")
    axes = list(figure.subplots(1, 2 + sum(extra)))
    _draw_stiffness(axes.pop(0), found.fit)
    _draw_drag(axes.pop(0), found.fit)
    if static is not None:
        _draw_loop(axes.pop(0), found, static)
    if found.ring is not None:
        _draw_ring(axes.pop(0), found)
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


def _draw_stiffness(axes: Axes, fit: TailFit) -> None:
    square = np.array([c.omega**2 for c in fit.conditions])
    response = np.array([c.response.real for c in fit.conditions])
    reach = 1.96 * np.array([c.deviation for c in fit.conditions])
    axes.errorbar(square, response, reach, fmt="o", ms=4, color=MEASURED, label="conditions")
    fine = np.linspace(0.0, square.max(), 200)
    label = r"$k - I\omega^2$" + (r"$ - J\omega^4$" if fit.mode else "")
    axes.plot(fine, fit.stiffness(fine), color=TWIN, label=label)
    axes.errorbar(0, fit.k_eff.value, _reach(fit.k_eff), fmt="s", color=TWIN, capsize=4)
    axes.set(
        title=f"k = {fit.k_eff.value:.4g} N m/rad, I = {fit.i_eff.value:.3g} kg m²",
        xlabel="ω² [rad²/s²]",
        ylabel="Re H [N m/rad]",
    )
    axes.legend()


def _reach(estimate: Estimate) -> list[list[float]]:
    low, high = estimate.interval
    return [[estimate.value - low], [high - estimate.value]]


def _draw_drag(axes: Axes, fit: TailFit) -> None:
    """Draw Im H, and Im H without the friction, which is a line through the origin."""
    omega = np.array([c.omega for c in fit.conditions])
    total = np.array([c.response.imag for c in fit.conditions])
    dry = np.array([4 * fit.coulomb.value / (np.pi * c.amplitude) for c in fit.conditions])
    axes.plot(omega, total, "o", ms=4, color=MEASURED, label="Im H")
    axes.plot(omega, total - dry, "s", ms=4, color=TWIN, label="without Coulomb part")
    fine = np.linspace(0.0, omega.max(), 200)
    label = r"$c\,\omega$" + (r"$(1 + J\omega^4/k)$" if fit.mode else "")
    axes.plot(fine, fit.drag(fine), color=TWIN, label=label)
    axes.set(
        title=f"c = {fit.c_eff.value:.3g} N m s/rad, F = {fit.coulomb.value:.3g} N m",
        xlabel="ω [rad/s]",
        ylabel="Im H [N m/rad]",
        ylim=(min(0.0, 1.1 * (total - dry).min()), None),
    )
    axes.legend()


def _draw_loop(axes: Axes, found: TailResult, static: Recording) -> None:
    angle, torque = static.columns["angle_rad"], static.columns["torque_nm"]
    axes.plot(angle, torque, color=MEASURED, lw=0.8, label="slow pull")
    assert found.loop is not None
    middle = [(values.max() + values.min()) / 2 for values in (angle, torque)]
    ends = np.array([angle.min(), angle.max()])
    for label, slope, colour in (
        (f"static fit, loading: {found.loop.loading:.3g}", found.loop.loading, ORANGE),
        (f"dynamic k: {found.fit.k_eff.value:.3g}", found.fit.k_eff.value, TWIN),
    ):
        axes.plot(ends, middle[1] + slope * (ends - middle[0]), color=colour, label=label)
    axes.set(title="hysteresis of the slow pull", xlabel="angle [rad]", ylabel="torque [N m]")
    axes.legend()


def _draw_ring(axes: Axes, found: TailResult) -> None:
    ring = found.ring
    assert ring is not None
    axes.plot(ring.time, ring.measured, ".", ms=3, color=MEASURED, label="released")
    axes.plot(ring.time, ring.fitted, color=TWIN, label="fit")
    axes.set(
        title=f"{ring.natural_frequency.value:.3g} Hz, ζ = {ring.damping_ratio.value:.3g}",
        xlabel="time [s]",
        ylabel=QUANTITIES.get(ring.column, f"{ring.column} [as recorded]"),
    )
    axes.legend()


# ---- servo --------------------------------------------------------------------------------------


@styled
def servo_fit(found: ServoFit, path: Path) -> None:
    """Per recording shown (a fitted and a held-out one): whole, one stroke; then all errors."""
    held_out = [o for o in found.overlays if o.role == "validate"]
    shown = [*held_out[:1], *[o for o in found.overlays if o.role == "fit"][:1]]
    figure = Figure(figsize=(12, 3.4 * len(shown)), layout="constrained")
    grid = figure.add_gridspec(len(shown), 3, width_ratios=[2, 1.4, 1])
    for row, overlay in enumerate(shown):
        whole = figure.add_subplot(grid[row, 0])
        _draw_overlay(whole, overlay, None)
        whole.set_title(f"{overlay.bench.name} ({overlay.role})")
        whole.legend(loc="upper right", fontsize="small")
        _draw_overlay(figure.add_subplot(grid[row, 1]), overlay, overlay.stroke)
    _draw_errors(figure.add_subplot(grid[:, 2]), found)
    with new_file(path) as beside:
        figure.savefig(beside, dpi=130)


@styled
def servo(overlays: Sequence[Overlay], path: Path) -> None:
    """Recordings of a servo that nothing was fitted to: whole, and one stroke."""
    figure = Figure(figsize=(10, 3.2 * len(overlays)), layout="constrained")
    grid = np.atleast_2d(figure.subplots(len(overlays), 2, width_ratios=[2, 1]))
    for (whole, stroke), overlay in zip(grid, overlays, strict=True):
        _draw_overlay(whole, overlay, None)
        whole.set_title(overlay.bench.name)
        whole.legend(loc="upper right", fontsize="small")
        _draw_overlay(stroke, overlay, overlay.stroke)
    with new_file(path, overwrite=True) as beside:
        figure.savefig(beside, dpi=130)


def _draw_overlay(axes: Axes, overlay: Overlay, window: tuple[float, float] | None) -> None:
    bench = overlay.bench
    for label, values, colour, style in (
        ("command", bench.command, COMMAND, "--"),
        ("idealised", overlay.idealised, IDEALISED, "-"),
        ("measured", bench.angle, MEASURED, "-"),
        ("identified", overlay.identified, TWIN, "-"),
    ):
        axes.plot(bench.time, np.degrees(values), style, color=colour, label=label, lw=1.2)
    reach = np.degrees(1.2 * max(np.nanmax(np.abs(bench.angle)), np.abs(bench.command).max()))
    axes.set(xlabel="time [s]", ylabel="angle [deg]", xlim=window, ylim=(-reach, reach))


def _draw_errors(axes: Axes, found: ServoFit) -> None:
    """Root mean square error of every recording, both servos."""
    place = np.arange(len(found.overlays))
    for which, colour, shift in (("idealised", IDEALISED, -0.2), ("identified", TWIN, 0.2)):
        rms = [o.rmse_deg(which) for o in found.overlays]
        axes.barh(place + shift, rms, 0.4, color=colour, label=which)
    labels = [f"{o.bench.name}{' *' if o.role == 'validate' else ''}" for o in found.overlays]
    axes.set_yticks(place, labels, fontsize="x-small")
    axes.set(xlabel="RMSE [deg], * held out")
    axes.invert_yaxis()
    axes.legend(fontsize="small")
    axes.grid(visible=False, axis="y")
