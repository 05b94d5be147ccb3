"""What do the learning verbs do? Train, show a policy, compare two, try one in the twin."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.control.policy import check_fits, differences, load_policy
from tailbeat.files import BadInput, need
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.report.learning_figures import courses

Report = Callable[[dict[str, Any]], None]


def train(
    fish: str,
    out: Path,
    actions: str,
    recipe: str,
    seed: int,
    hours: float,
    resume: bool,
    device: str,
    servo: str | None,
    binds: str | None,
    floor: float,
    stage: str | None,
    report: Report,
    note: Callable[[str], None],
) -> dict[str, Any]:
    """Train a policy into a folder; what came of it."""
    _need_extra()
    from tailbeat.train.config import Plan, action_space  # needs the extra
    from tailbeat.train.recipes import recipe_of
    from tailbeat.train.train import train as run

    described, chosen = with_servo(load_fish(fish), servo), recipe_of(recipe)
    space = action_space(actions, described, binds or chosen.binds, floor)
    plan = Plan(described, space, chosen, seed, out, hours, device)
    note(f"replay buffer: {chosen.buffer_bytes / 1e6:.0f} MB of memory and of every checkpoint")
    course = run(plan, resume, report, stage)
    courses({f"{actions}, seed {seed}": vars(course)}, out / "curve.png")
    return {
        "folder": str(out),
        "policy": str(out / "policy.onnx"),
        "stages_passed": course.passed(),
        "stages": sum(not one.by_hand for one in chosen.stages),
        "finished": course.finished,
        "stalled": course.stalled,
        "hours": course.seconds / 3600,
        "promotions": course.promotions,
        "last": course.history[-1] if course.history else None,
    }


def with_servo(fish: Fish, servo: str | None) -> Fish:
    """The fish with another of its servos, or as described."""
    if servo is not None and servo not in fish.servos:
        raise BadInput(f"--servo {servo!r}: {fish.name} has {', '.join(fish.servos)}.")
    return fish.model_copy(update={"servo": servo or fish.servo})


def _need_extra() -> None:
    need("training", "train", "stable_baselines3", "onnx", "tensorboard")


def show_policy(path: str) -> dict[str, Any]:
    """The contract of a policy, golden pairs checked."""
    return asdict(load_policy(path).contract)


def diff_policies(a: str, b: str) -> list[dict[str, Any]]:
    """Every field in which two contracts differ."""
    return differences(load_policy(a).contract, load_policy(b).contract)


def try_policy(
    path: str, fish: str, arc: float, count: int, seed: int, exact: bool, pools: int
) -> dict[str, Any]:
    """Swim a policy to seeded targets: in the twin with all noise and randomisation (`exact`:
    undisturbed), or in `pools` waters of the virtual pool's ensemble."""
    _need_extra()
    from tailbeat.env.curriculum import Stage, settings_of
    from tailbeat.env.world import PERIOD
    from tailbeat.evaluate.reach import in_pool, in_twin, reach
    from tailbeat.pool.water import ensemble

    if not 0 < arc <= 180 or count < 1 or pools < 0:
        raise BadInput(
            f"--arc {arc:g}, --targets {count}, --pools {pools}: allowed are 0 to 180, 1 and more,"
            f" 0 and more."
        )
    policy, described = load_policy(path), load_fish(fish)
    held = policy.contract
    who = (held.fish, held.fish_digest) if pools else (described.name, digest(described))
    check_fits(held, *who, described.band, PERIOD)
    share = 0.0 if exact else 1.0
    stage = Stage("trial", 3, share, share, float(np.radians(arc)))
    settings = settings_of(stage, held.actions)
    waters = ensemble(pools, seed) if pools else []
    build = in_pool(described, settings, waters) if pools else in_twin(described, settings)
    return {"policy": path, "arc_deg": arc, "pools": pools, **reach(policy, build, count, seed)}
