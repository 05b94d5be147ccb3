"""A fish that swims open-loop, without a policy; picture, film and summary are left behind."""

from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.evaluate import figures
from tailbeat.files import write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.render import save_film, save_picture
from tailbeat.fish.rollout import Start, Swim, replay_command, swim
from tailbeat.fish.twin import Options, Twin, compile_twin

SECONDS = 8.0


def open_loop(fish: Fish, out: Path) -> dict[str, Any]:
    """Beat a fish open-loop and write picture, film, figure and summary under `out`."""
    frequency = 1.5 if fish.motor.kind == "pulley" else 1.0
    done, twin = _beat(fish, frequency)
    figures.open_loop(done, twin.motor, out / "open-loop.png", True)
    report = {"fish": fish.name, "beat_frequency": frequency, **_figures(done)}
    report |= _film(twin, done, out)
    write_json(out / "summary.json", report, overwrite=True)
    return report


def _beat(fish: Fish, frequency: float) -> tuple[Swim, Twin]:
    """From rest: a pulley swung by 0.6 rad through its servo, a crank turned steadily."""
    crank = fish.motor.kind == "crank"
    twin = compile_twin(fish, Options(replayed=crank, looks=True))
    step = twin.model.opt.timestep
    phase = 2 * np.pi * frequency * np.arange(0, SECONDS + step, step)
    if crank:
        start = Start(np.zeros(3), np.zeros(3), 0.0, 2 * np.pi * frequency)
        return swim([twin], [start], [replay_command(twin, phase)], round(0.02 / step))[0], twin
    command = 0.6 * np.sin(phase)
    return swim([twin], [Start.at_rest()], [command], max(round(0.02 / step), 1))[0], twin


def _figures(done: Swim) -> dict[str, Any]:
    """Speed over the last half, and how far the fish got."""
    half = done.time.size // 2
    path = done.qpos[half:, :2]
    return {
        "seconds": done.time[-1],
        "distance_m": float(np.linalg.norm(done.qpos[-1, :2] - done.qpos[0, :2])),
        "speed_m_s": float(np.linalg.norm(path[-1] - path[0]) / (done.time[-1] - done.time[half])),
    }


def _film(twin: Twin, done: Swim, out: Path) -> dict[str, Any]:
    how = save_picture(twin, done.qpos[-1], out / "fish.png", overwrite=True)
    save_film(twin, done.time, done.qpos, out / "swim.mp4", overwrite=True)
    files = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    return {"rendered": how, "folder": str(out), "files": sorted({*files, "summary.json"})}
