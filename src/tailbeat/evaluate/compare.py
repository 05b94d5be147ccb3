"""The controlled comparison: policies of several kinds, one twin, one pool, piece by piece.

Every policy swims the same targets in its twin and in every arm of the pool: the full water, the
same without its lag, stall or added inertia, with another servo, and the ensemble.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import Policy, decide, load_policy
from tailbeat.env.simulator import TwinSimulator
from tailbeat.env.world import seeds_from
from tailbeat.evaluate import runs as store
from tailbeat.evaluate.evaluation import ENSEMBLE_SEED, POOLS, provenance, read_json
from tailbeat.evaluate.reach import paired, shares
from tailbeat.evaluate.runs import NEAR, Runs, surge
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.spectrum import SHARES, power_shares, windows
from tailbeat.evaluate.trial import CHUNK, Arm, Progress, part, pools, swim
from tailbeat.files import BadInput, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.identify.runs import tracked_pose
from tailbeat.pool.water import ablations, ensemble
from tailbeat.robot.fits import check_swims

IDEAL = "idealised"  # the servo's name in a description


@dataclass(frozen=True, eq=False)
class Entrant:
    """A policy by name, with the twin (and servo) that it was trained in."""

    name: str
    policy: Policy
    twin: Fish


@dataclass(frozen=True)
class Field:
    """Where they swim: the pool's fish, how many targets, drawn from which seed."""

    fish: Fish
    count: int
    seed: int


def compare(
    policies: Sequence[str],
    fish: str,
    twin: str | None,
    targets: int,
    seed: int,
    share: str,
    out: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Swim every policy in every arm of the pool; numbers of all cells that are there."""
    own, entrants = load_fish(fish), []
    if targets < 2:
        raise BadInput(f"--targets {targets}: give 2 or more.")
    for name in policies:
        policy = load_policy(name)
        entrants.append(Entrant(_label(name), policy, check_swims(policy, twin, own)))
    if len({one.name for one in entrants}) < len(entrants):
        raise BadInput("two policies of the same name; rename a file or its folder.")
    field = Field(own, targets, seed)
    run(entrants, field, out, _share(share), progress)
    found = read(out)
    write_json(out / "comparison.json", found, overwrite=True)
    return found


def _label(policy: str) -> str:
    """A run's folder where the file has the name that every run gives it."""
    path = Path(policy)
    return path.parent.name if path.name == "policy.onnx" else path.stem


def _share(text: str) -> tuple[int, int]:
    """`i/n` as an index from 0 and a count."""
    first, _, count = text.partition("/")
    if not (first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise BadInput(f"--share {text!r}: give i/n, from 1/n to n/n, one process each.")
    return int(first) - 1, int(count)


def pool_arms(entrant: Entrant, field: Field) -> list[Arm]:
    """The pool, whole and without one piece at a time; the twin comes first."""
    fish, n = field.fish, field.count
    scene = grid(fish, n, field.seed, 0.5, 2.5, float(np.radians(120)))
    space = entrant.policy.contract.actions
    full = Arm("full", fish, scene, space, pools([ablations()["full"]], n))
    own = fish.servos[fish.servo]
    prompt = own.model_copy(update={"delay": 0.0})
    arms = [Arm("twin", entrant.twin, scene, space, None), full]
    arms += [
        replace(full, name=name, water=pools([water], n))
        for name, water in ablations().items()
        if name != "full"
    ]
    arms.append(replace(full, name="no delay", servo=prompt))
    if IDEAL in fish.servos:
        arms.append(replace(full, name="ideal servo", servo=fish.servos[IDEAL]))
    arms.append(replace(full, name="ensemble", water=pools(ensemble(POOLS, ENSEMBLE_SEED), n)))
    return arms


def run(
    entrants: Sequence[Entrant], field: Field, out: Path, share: tuple[int, int], report: Progress
) -> None:
    """Swim the cells that are missing; of `share` (i, n) only every n-th, from the i-th, so that n
    processes do all. Each cell is a file."""
    cells = [(one, arm) for one in entrants for arm in pool_arms(one, field)]
    mine = cells[share[0] :: share[1]]
    for done, (entrant, arm) in enumerate(mine):
        path = cell_path(out, entrant.name, arm.name)
        if not path.is_file():
            write_json(path, cell(entrant, arm, field))
        report(f"{entrant.name}, {arm.name}", done + 1, len(mine))


def cell_path(out: Path, policy: str, arm: str) -> Path:
    """Where one cell lies."""
    return out / "cells" / f"{policy}.{arm.replace(' ', '-')}.json"


def cell(entrant: Entrant, arm: Arm, field: Field) -> dict[str, Any]:
    """One policy in one arm: what it reached, and how it swam."""
    seeds = seeds_from(field.seed, arm.count)
    choose = partial(decide, entrant.policy)
    parts = [(part(arm, k), seeds[k * CHUNK :][:CHUNK]) for k in range(arm.chunks)]
    found = store.joined([swim(choose, own, some) for own, some in parts])
    contract = entrant.policy.contract
    return {
        "policy": entrant.name,
        "actions": contract.actions.kind,
        "servo": entrant.twin.servo,
        "seed": contract.training.get("seed"),
        "stage": contract.training.get("stage"),
        "arm": arm.name,
        "targets": arm.count,
        "field": [field.fish.name, field.count, field.seed],
        **shares(found.reached, found.nearest),
        **manner(found, contract.band),
        "speed_in_twin": None if arm.name == "twin" else replayed(found, entrant.twin),
        "hits_5cm": found.reached.tolist(),
        "hits_20cm": (found.nearest < NEAR).tolist(),
    }


def manner(found: Runs, band: tuple[float, float]) -> dict[str, Any]:
    """How the fish swam: speed [m/s], power of the actuator [W], turns of the gait per minute, and
    the shares of the motor's velocity power below, inside and above a band [Hz]."""
    speed, time = surge(found), PERIOD * found.steps
    signs = [np.sign(np.where(np.abs(row) < 0.02, np.nan, row)) for row in speed]
    turns = sum(int((np.diff(one[np.isfinite(one)]) != 0).sum()) for one in signs)
    energy = np.asarray(found.energy, float)
    power = power_shares(windows(found, speed, None), band)
    return {
        "speed": path_speed(found.pose),
        "actuator_watts": float(np.nansum(energy) / time.sum())
        if np.isfinite(energy).any()
        else None,
        "reversals_per_minute": 60 * turns / float(time.sum()),
        **{name: power[name] for name in SHARES},
    }


def path_speed(pose: Any) -> float:
    """Mean speed over ground [m/s] along ways (n, k, 3), NaN behind their ends."""
    step = np.diff(pose[..., :2], axis=1)
    return float(np.nanmean(np.hypot(step[..., 0], step[..., 1])) / PERIOD)


def replayed(found: Runs, twin: Fish) -> float:
    """Mean speed [m/s] of the twin, undrawn, under the very setpoints of these swims."""
    simulator = TwinSimulator(twin, found.count)
    simulator.rest(np.arange(found.count))
    simulator.ready(np.arange(found.count))
    pose = np.full_like(found.pose, np.nan)
    pose[:, 0], none = tracked_pose(twin, np.zeros(3)), np.zeros((found.count, 2))
    for step in range(found.setpoint.shape[1]):
        command = found.setpoint[:, step].astype(float)
        going = np.isfinite(command)
        lost = simulator.advance(np.where(going, command, 0.0), none)
        going &= ~lost
        pose[going, step + 1] = tracked_pose(twin, simulator.qpos[:, :3])[going]
    return path_speed(pose)


# ---- reading ------------------------------------------------------------------------------------


def has_rows(out: Path) -> bool:
    """Whether a folder holds cells of a comparison."""
    return any((out / "cells").glob("*.json"))


def read(out: Path) -> dict[str, Any]:
    """All cells: a row each with its gap to the twin, and a row per kind and arm over the seeds."""
    cells = [read_json(path) for path in sorted((out / "cells").glob("*.json"))]
    if not cells:
        raise BadInput(f"{out}: no cells of a comparison here; `tailbeat compare` makes them.")
    if len({tuple(one["field"]) for one in cells}) > 1:
        raise BadInput(f"{out}: cells of several comparisons; give every one a folder of its own.")
    twins = {one["policy"]: one for one in cells if one["arm"] == "twin"}
    rows = [_row(one, twins.get(one["policy"])) for one in cells]
    pooled = [row for row in rows if row["arm"] != "twin"]
    return {"rows": rows, "kinds": _kinds(pooled), "provenance": provenance()}


def _row(one: dict[str, Any], twin: dict[str, Any] | None) -> dict[str, Any]:
    kept = {k: v for k, v in one.items() if not k.startswith("hits") and k != "field"}
    kept |= {name: one.get(name) for name in SHARES}  # older cells hold the first alone
    gaps = {f"gap_{k}": _gap(one, twin, k) if twin else None for k in ("5cm", "20cm")}
    return kept | gaps


def _gap(one: dict[str, Any], twin: dict[str, Any], key: str) -> dict[str, Any]:
    """Twin less pool over the same targets."""
    return paired(np.array(one[f"hits_{key}"]), np.array(twin[f"hits_{key}"]))


def _kinds(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean over the seeds of a kind in an arm; the interval is that of the targets and seeds pooled
    as if independent."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["actions"], row["servo"], row["arm"]), []).append(row)
    return [_kind(*key, own) for key, own in groups.items()]


def _kind(actions: str, servo: str, arm: str, own: list[dict[str, Any]]) -> dict[str, Any]:
    gaps = [row["gap_20cm"] for row in own if row["gap_20cm"]]
    mean = float(np.mean([gap["difference"] for gap in gaps])) if gaps else float("nan")
    halves = [gap["interval"][1] - gap["difference"] for gap in gaps]
    half = float(np.sqrt(np.square(halves).sum()) / len(gaps)) if gaps else float("nan")
    means = {
        name: float(np.mean([row[name] for row in own if row[name] is not None] or [np.nan]))
        for name in ("within_5cm", "within_20cm", *SHARES, "actuator_watts",
                     "reversals_per_minute", "speed", "speed_in_twin")
    }  # fmt: skip
    seeds = {"actions": actions, "servo": servo, "arm": arm, "policies": len(own)}
    return {**seeds, **means, "gap_20cm": mean, "gap_interval_20cm": [mean - half, mean + half]}
