"""Picture, film, figure and summary of a fish that swims open-loop, without a policy."""

from dataclasses import dataclass
from pathlib import Path

from tailbeat.evaluate.open_loop import OpenLoop, beat, summary
from tailbeat.files import write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.render import save_film, save_picture
from tailbeat.report import figures


@dataclass(frozen=True)
class OpenLoopReport(OpenLoop):
    """An open-loop swim of a `fish` at a beat frequency [Hz], how it was `rendered`, and its
    files."""

    fish: str
    beat_frequency: float
    rendered: str
    folder: str
    files: tuple[str, ...]


def open_loop(fish: Fish, out: Path) -> OpenLoopReport:
    """Swim a fish open-loop and write picture, film, figure and summary under `out`."""
    frequency = 1.5 if fish.motor.kind == "pulley" else 1.0
    done, twin = beat(fish, frequency)
    figures.open_loop(done, twin.motor, out / "open-loop.png", True)
    how = save_picture(twin, done.qpos[-1], out / "fish.png", overwrite=True)
    save_film(twin, done.time, done.qpos, out / "swim.mp4", overwrite=True)
    files = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    named = tuple(sorted(files | {"summary.json"}))
    found = vars(summary(done))
    report = OpenLoopReport(**found, fish=fish.name, beat_frequency=frequency, rendered=how,
                            folder=str(out), files=named)  # fmt: skip
    write_json(out / "summary.json", report, overwrite=True)
    return report
