"""Figures. Draws what others computed; computes nothing."""

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.evaluate.speed_map import SpeedMap, SpeedRow
from tailbeat.files import new_file
from tailbeat.fish.rollout import Swim
from tailbeat.identify.gait import distance, head_frame, last_seconds, phase_shift
from tailbeat.identify.predict import Prediction
from tailbeat.report.style import COMMAND, LIMIT, MEASURED, POOL, TWIN, label_ends, styled

MARKERS = ("o", "s", "^", "D", "v")  # of the shaft's speeds


@styled
def measured_against_twin(
    rows: Sequence[tuple[str, Prediction]], path: Path, overwrite: bool = False
) -> None:
    """One row per run (role, prediction): the path or body wave, the tail's beat, the figures."""
    figure = Figure(figsize=(11, 3.4 * len(rows)), layout="constrained")
    for axes, (role, prediction) in zip(
        np.atleast_2d(figure.subplots(len(rows), 3)), rows, strict=True
    ):
        _draw_path(axes[0], prediction, f"{prediction.run.name} ({role})")
        _draw_beat(axes[1], prediction)
        _draw_figures(axes[2], prediction)
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


def _draw_path(axes: Axes, prediction: Prediction, title: str) -> None:
    """Distance swum along the heading for a cruise, the path in the plane for a replay."""
    for label, colour, track in (
        ("measured", MEASURED, prediction.run.track),
        ("twin", TWIN, prediction.track),
    ):
        if prediction.run.motor is None:
            late = last_seconds(track, prediction.run.track.time[-1])
            axes.plot(late.time - late.time[0], distance(late), color=colour, label=label)
        else:
            axes.plot(track.pose[:, 0], track.pose[:, 1], color=colour, label=label)
    cruise = prediction.run.motor is None
    axes.set(
        title=title,
        xlabel="time [s]" if cruise else "x [m]",
        ylabel="distance along the heading [m]" if cruise else "y [m]",
    )
    if cruise:
        label_ends(axes)
    else:
        axes.legend()


def _draw_beat(axes: Axes, prediction: Prediction) -> None:
    """Sideways motion of the tip in the head frame, the twin's shifted to the same phase."""
    run = prediction.run
    if run.track.markers is None or not np.isfinite(run.gait.tail_amplitude):
        axes.plot(run.track.time, run.track.pose[:, 2], color=MEASURED, label="measured")
        axes.plot(prediction.track.time, prediction.track.pose[:, 2], color=TWIN, label="twin")
        axes.set(xlabel="time [s]", ylabel="heading [rad]")
        label_ends(axes)
        return
    measured = head_frame(run.track)[:, run.track.tip, 1]
    time = run.track.time - run.track.time[0]
    late = last_seconds(prediction.track, time[-1])
    when, twin = late.time - late.time[0], head_frame(late)[:, late.tip, 1]
    shift = phase_shift(time, measured, when, twin, run.gait.frequency)
    axes.plot(time, 1e3 * (measured - np.nanmean(measured)), color=MEASURED, label="measured")
    axes.plot(when + shift, 1e3 * (twin - twin.mean()), color=TWIN, label="twin")
    axes.set(xlabel="time [s]", ylabel="fin tip sideways [mm]", xlim=(0, time[-1]))
    label_ends(axes)


def _draw_figures(axes: Axes, prediction: Prediction) -> None:
    """Measured and predicted speed, stride, Strouhal number and stroke as pairs of bars."""
    measured, twin = prediction.run.gait, prediction.gait
    names = ["speed\n[m/s]", "stride\n[m]", "stroke\n[m]", "Strouhal\n/ 10 [-]"]
    values = [[g.speed, g.stride, g.tail_amplitude, g.strouhal / 10] for g in (measured, twin)]
    place = np.arange(len(names))
    axes.bar(place - 0.2, values[0], 0.4, color=MEASURED, label="measured")
    axes.bar(place + 0.2, values[1], 0.4, color=TWIN, label="twin")
    axes.set_xticks(place, names)
    axes.set_ylabel("value [unit as below]")
    axes.legend()
    beat = f"{measured.frequency:.3f} Hz" if np.isfinite(measured.frequency) else "no steady beat"
    axes.set_title(f"{beat}, marker error {1e3 * prediction.marker_error:.1f} mm")
    axes.grid(visible=False, axis="x")


@styled
def speeds(
    fitted: Sequence[Prediction],
    validated: Sequence[Prediction],
    path: Path,
    overwrite: bool = False,
) -> None:
    """Speed over beat frequency: fitted (filled) and held-out runs, measured and predicted."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for label, rows, fill in (("fitted", fitted, "full"), ("held out", validated, "none")):
        x = [p.run.gait.frequency for p in rows]
        measured = [p.run.gait.speed for p in rows]
        twin = [p.gait.speed for p in rows]
        axes.plot(x, measured, "o", color=MEASURED, fillstyle=fill, label=f"measured, {label}")
        axes.plot(x, twin, "s", color=TWIN, fillstyle=fill, label=f"twin, {label}")
    axes.set(xlabel="beat frequency [Hz]", ylabel="speed [m/s]", xlim=(0, None), ylim=(0, None))
    axes.legend()
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


@styled
def speed_map(report: SpeedMap, path: Path, overwrite: bool = False) -> None:
    """Speed of twin and pool over frequency, one panel per servo, one marker per shaft speed."""
    servos = list(dict.fromkeys(row.servo for row in report.rows))
    figure = Figure(figsize=(5.5 * len(servos), 4), layout="constrained")
    for axes, servo in zip(np.atleast_1d(figure.subplots(1, len(servos))), servos, strict=True):
        own = [row for row in report.rows if row.servo == servo]
        rates = dict.fromkeys(row.shaft_speed for row in own)
        for marker, rate in zip(cycle(MARKERS), rates, strict=False):
            rows = [row for row in own if row.shaft_speed == rate]
            _draw_speeds(axes, rows, marker, f"{rate:g} rad/s")
        axes.axhline(0, color=LIMIT, lw=0.8)
        axes.set(title=f"servo: {servo}", xlabel="frequency [Hz]", ylabel="speed [m/s]")
        axes.legend(fontsize="small")
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


def _draw_speeds(axes: Axes, rows: Sequence[SpeedRow], marker: str, label: str) -> None:
    beats = [row.frequency for row in rows]
    for name, speeds, line, colour in (
        ("pool", [row.plant for row in rows], "-", POOL),
        ("twin", [row.twin for row in rows], "--", TWIN),
    ):
        axes.plot(beats, np.array(speeds, float), line + marker, ms=4, color=colour,
                  label=f"{name}, {label}")  # fmt: skip


@styled
def open_loop(swim: Swim, motor: int, path: Path, overwrite: bool = False) -> None:
    """Path of the head and the angles of motor and tail of one open-loop swim."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    plane, angles = figure.subplots(1, 2)
    plane.plot(swim.qpos[:, 0], swim.qpos[:, 1], color=TWIN)
    plane.set(xlabel="x [m]", ylabel="y [m]", title="path of the fish frame")
    plane.set_aspect("equal", adjustable="datalim")
    angles.plot(swim.time, swim.qpos[:, motor], color=COMMAND, label="motor")
    angles.plot(swim.time, swim.qpos[:, motor + 1 :].sum(axis=1), color=TWIN, label="tail, sum")
    angles.set(xlabel="time [s]", ylabel="angle [rad]")
    label_ends(angles)
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)
