"""A policy's evaluation in the pool: all trials swum into a folder, then read into numbers."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat import __version__
from tailbeat.control.policy import Policy, as_text, decide
from tailbeat.evaluate import disturb, fresh_recordings, reach, runs, spectrum, track
from tailbeat.evaluate import out_of_distribution as beyond
from tailbeat.evaluate.names import NAMES, TRIALS
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.speed_map import speed_map
from tailbeat.evaluate.trial import CHUNK, Arm, Pool, Progress, swim_all
from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import digest, load_fish
from tailbeat.pool.water import Water, ablations, ensemble, fingerprint
from tailbeat.robot.fits import check_swims

TASKS: dict[str, Any] = dict(zip(TRIALS, (reach, disturb, track, beyond), strict=True))
POOLS = 16  # waters of the ensemble
ENSEMBLE_SEED = 0


def waters_of(name: str) -> tuple[Water, ...]:
    """The waters of `--pool`: "ensemble", or one of the ablations ("full" is the default one)."""
    if name == "ensemble":
        return tuple(ensemble(POOLS, ENSEMBLE_SEED))
    if name not in ablations():
        raise BadInput(f"--pool {name!r}: allowed are ensemble, {', '.join(ablations())}.")
    return (ablations()[name],)


def pool_of(
    policy: Policy,
    fish: str,
    twin: str | None,
    pool: str,
    episodes: int,
    seed: int,
    walls: str = "5.5x2.7",
) -> Pool:
    """Where a policy is tried; raises BadInput where it does not fit the pool's fish."""
    if episodes < 2:
        raise BadInput(f"--episodes {episodes}: give 2 or more.")
    own = load_fish(fish)
    trained = check_swims(policy, twin, own)
    waters = waters_of(pool)
    actions = policy.contract.actions
    return Pool(own, trained, actions, waters, episodes, seed, _walls(walls))


def _walls(text: str) -> tuple[float, float]:
    """`length x width` in metres."""
    try:
        length, width = map(float, text.split("x"))
    except ValueError:
        raise BadInput(f"--walls {text!r}: give length x width in metres, as 5.5x2.7.") from None
    return length, width


def arms_of(pool: Pool, tasks: Sequence[str]) -> list[Arm]:
    """All arms of some tasks; the spectrum reads those of `reach`."""
    return [arm for name in tasks if name in TASKS for arm in TASKS[name].arms(pool)]


def evaluate(
    policy: Policy, pool: Pool, tasks: Sequence[str], out: Path, progress: Progress
) -> dict[str, Any]:
    """Swim what is not there yet, then `read`; takes up where it was stopped."""
    for name in tasks:
        if name not in NAMES:
            raise BadInput(f"--tasks {name}: allowed are {', '.join(NAMES)}.")
    swum = dict.fromkeys(["reach", *tasks] if "spectrum" in tasks else tasks)
    arms = arms_of(pool, list(swum))
    runs.begin(out, plan_of(policy, pool))
    swim_all(partial(decide, policy), arms, out, pool.seed, progress)
    if "twin" in tasks:
        fresh_recordings.record(pool.fish, out / "twin", pool.seed)
        found = fresh_recordings.numbers(out / "twin", pool.twin)
        found["speeds"] = speed_map(pool.fish, [pool.twin.servo], pool.twin)
        write_json(out / "twin" / "twin.json", found, overwrite=True)
    if "spectrum" in tasks:
        own = spectrum.identification(pool.fish, policy.contract.band, pool.seed)
        write_json(out / "identification.json", own, overwrite=True)
    done = read(out)
    write_json(out / "evaluation.json", done, overwrite=True)
    return done


def plan_of(policy: Policy, pool: Pool) -> dict[str, Any]:
    """What an evaluation is made of; a folder holds one."""
    contract = policy.contract
    return {
        "policy": hashlib.sha256(as_text(contract).encode()).hexdigest()[:16],
        "actions": contract.actions.kind,
        "band": list(contract.band),
        "training": contract.training,
        "twin": contract.fish,
        "fish": pool.fish.name,
        "fish_digest": digest(pool.fish),
        "water": fingerprint(pool.waters),
        "waters": len(pool.waters),
        "seed": pool.seed,
        "episodes": pool.count,
        "walls": list(pool.walls),
        "arms": counts(pool),
    }


def counts(pool: Pool) -> dict[str, int]:
    """Swims of every arm that these walls allow."""
    found: dict[str, int] = {}
    for name in TASKS:
        with suppress(BadInput):
            found |= {arm.name: arm.count for arm in TASKS[name].arms(pool)}
    return found


def read(out: Path) -> dict[str, Any]:
    """Numbers of all that was swum in a folder; arms that were cut short are named."""
    plan = runs.read_plan(out)
    held = {name: runs.load(out, name, -(-n // CHUNK)) for name, n in present(out, plan).items()}
    if not held and not (out / "twin" / "twin.json").is_file():
        raise BadInput(f"{out}: an empty folder of runs; evaluate into it first.")
    by_arm = {name: one for name, (one, _) in held.items()}
    found: dict[str, Any] = {"plan": plan, "provenance": provenance()}
    found["cut_short"] = [name for name, (_, short) in held.items() if short]
    swum = {task: _of(by_arm, task) for task in TASKS}
    found["reach"] = {name: reach.numbers(one) for name, one in swum["reach"].items()}
    for task in ("disturb", "track", "beyond"):
        reference = {"disturb": disturb.CALM, "beyond": beyond.AS_TRAINED}.get(task)
        if swum[task] and (reference is None or reference in swum[task]):
            found[task] = TASKS[task].numbers(swum[task])
    found["spectrum"] = spectrum.numbers(swum["reach"], tuple(plan["band"]))
    if (out / "identification.json").is_file():
        own = spectrum.complete(read_json(out / "identification.json"))
        found["spectrum"] = [own, *found["spectrum"]]
    if (out / "twin" / "twin.json").is_file():
        found["twin"] = read_json(out / "twin" / "twin.json")
    return found


def read_json(path: Path) -> Any:
    """What a JSON file of ours holds."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise BadInput(f"{path}: not readable JSON; evaluate again.") from None


def present(out: Path, plan: dict[str, Any]) -> dict[str, int]:
    """Arms of which at least one chunk was swum, and how many swims were asked for."""
    return {
        name: count
        for name, count in plan["arms"].items()
        if any(runs.chunk_path(out, name, k).is_file() for k in range(-(-count // CHUNK)))
    }


def _of(by_arm: dict[str, Runs], task: str) -> dict[str, Runs]:
    return {name: one for name, one in by_arm.items() if name.startswith(task)}


def provenance() -> dict[str, Any]:
    """Which code, on which machine."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short=12", "HEAD"]
    try:
        commit = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "not a checkout"
    return {
        "tailbeat": __version__,
        "commit": commit,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
    }
