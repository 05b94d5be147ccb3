"""How a policy was trained, for its contract."""

from stable_baselines3 import SAC

from tailbeat.env.task import Settings
from tailbeat.train.config import RunConfig
from tailbeat.train.export import Facts
from tailbeat.train.progress import Progress
from tailbeat.train.sac import QuickSAC


def facts(run: RunConfig, progress: Progress, model: SAC, settings: Settings) -> Facts:
    """What a run has done so far; `settings` are its world's."""
    return {
        "stage": run.recipe.stages[progress.stage].name,
        "stages_passed": progress.passed(),
        "seed": run.seed,
        "recipe": run.recipe.name,
        "horizon": round(run.recipe.horizon, 3),
        "physics": run.record().physics,
        "errors": _widths(run.errors),
        "build": _widths(run.build),
        "hard": _widths(run.hard),
        "updates": model._n_updates,
        "control_steps": progress.control_steps,
        "hours": round(progress.seconds / 3600, 3),
        "target_speed": settings.task.target_speed,
        "rounded": isinstance(model, QuickSAC) and model.rounded,
    }


def _widths(widths: object | None) -> str:
    """Sizes of what was drawn in training, in SI."""
    given = {} if widths is None else {name: w for name, w in vars(widths).items() if w}
    return ", ".join(f"{name} {width:.3g}" for name, width in given.items()) or "none"
