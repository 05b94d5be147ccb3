"""Picture, film, figure and summary of a fish that swims open-loop, without a policy."""

from pathlib import Path
from typing import Any

from tailbeat.evaluate.open_loop import beat, summary
from tailbeat.files import write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.render import save_film, save_picture
from tailbeat.fish.rollout import Swim
from tailbeat.fish.twin import Twin
from tailbeat.report import figures


def open_loop(fish: Fish, out: Path) -> dict[str, Any]:
    """Beat a fish open-loop and write picture, film, figure and summary under `out`."""
    frequency = 1.5 if fish.motor.kind == "pulley" else 1.0
    done, twin = beat(fish, frequency)
    figures.open_loop(done, twin.motor, out / "open-loop.png", True)
    report = {"fish": fish.name, "beat_frequency": frequency, **summary(done)}
    report |= _film(twin, done, out)
    write_json(out / "summary.json", report, overwrite=True)
    return report


def _film(twin: Twin, done: Swim, out: Path) -> dict[str, Any]:
    how = save_picture(twin, done.qpos[-1], out / "fish.png", overwrite=True)
    save_film(twin, done.time, done.qpos, out / "swim.mp4", overwrite=True)
    files = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    return {"rendered": how, "folder": str(out), "files": sorted({*files, "summary.json"})}
