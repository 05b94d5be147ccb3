"""The controlled comparison: policies of several kinds in one twin and one pool.

Every policy swims to the same targets in its twin and under every condition of the pool: the full
water, the water without lag, stall or added inertia, another servo, the ensemble, and labs that
get things wrong.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import Policy, contract_digest, decide, load_policy
from tailbeat.env.simulator import TwinSimulator
from tailbeat.env.task import as_seen
from tailbeat.env.world import seeds_from
from tailbeat.evaluate import store
from tailbeat.evaluate.comparison import TWIN, Cell, Comparison, cell_path, cells_in, read
from tailbeat.evaluate.evaluation import ENSEMBLE_SEED, POOLS
from tailbeat.evaluate.messy import at_level
from tailbeat.evaluate.rates import success
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.spectrum import power_shares, windows
from tailbeat.evaluate.trial import CHUNK, Condition, part, pools, swim
from tailbeat.files import BadInput, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.pool import mess
from tailbeat.pool.water import ablations, ensemble, fingerprint
from tailbeat.robot.fits import check_swims

IDEAL = "idealised"  # the servo's name in a description
MESSY = ("everyday", "rough")  # levels of the labs; at wrecked every kind misses most targets


@dataclass(frozen=True)
class ComparisonConfig:
    """Which `policies` (names or files) swim to how many `targets`, drawn from `seed`. `fish` is
    the pool's fish, `twin` the one that they were trained in (None: the one that each policy
    names). `only` are the names of the conditions; empty, all."""

    policies: tuple[str, ...]
    fish: str = "pulley-fish"
    twin: str | None = None
    targets: int = 100
    seed: int = 0
    only: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Entrant:
    """A policy with its name and the twin (and servo) that it was trained in."""

    name: str
    policy: Policy
    twin: Fish


@dataclass(frozen=True)
class Field:
    """The pool's fish, the number of targets, and the seed that draws them."""

    fish: Fish
    count: int
    seed: int


def cells_of(config: ComparisonConfig) -> list[tuple[str, str]]:
    """Policy's name and condition of every cell. Raises BadInput if a policy does not fit."""
    if config.targets < 2:
        raise BadInput(f"--targets {config.targets}: give 2 or more.")
    field = field_of(config)
    entrants = [_entrant(name, config.twin, field.fish) for name in config.policies]
    if len({one.name for one in entrants}) < len(entrants):
        raise BadInput("two policies have the same name; rename a file or its folder.")
    found = [(one.name, own.name) for one in entrants for own in conditions_of(one, field)]
    names = dict.fromkeys(condition for _, condition in found)
    for name in config.only:
        if name not in names:
            raise BadInput(f"--only {name!r}: not a condition; allowed are {', '.join(names)}.")
    return [cell for cell in found if not config.only or cell[1] in config.only]


def cells_left(config: ComparisonConfig, out: Path) -> list[tuple[str, str]]:
    """The cells of `cells_of` that are not in the folder `out`. Raises BadInput if one there was
    swum with other options, in another pool, or by a policy that has been trained anew since."""
    cells, own, wanted = cells_of(config), field_of(config), digests_of(config)
    pool = pool_digest(own.fish)
    for path, held in cells_in(out):
        wrong = _unlike(held, own, pool)
        if held.digest not in (None, wanted.get(held.policy, held.digest)):
            wrong.append(f"policy {held.policy} is another one now")
        if wrong:
            raise BadInput(f"{path}: {'; '.join(wrong)}. Use the same ones, or a new folder.")
    return [one for one in cells if not cell_path(out, *one).is_file()]


def digests_of(config: ComparisonConfig) -> dict[str, str]:
    """Digests of the policies, by their names in the cells."""
    return {_label(name): contract_digest(load_policy(name).contract) for name in config.policies}


def _unlike(held: Cell, own: Field, pool: str) -> list[str]:
    """What differs between a cell on disk and a field with the digest `pool`."""
    now = (own.fish.name, own.count, own.seed)
    found = [
        f"{name} was {before}, now {after}"
        for name, before, after in zip(
            ("--fish", "--targets", "--seed"), held.field, now, strict=True
        )
        if before != after
    ]
    if not found and held.pool not in (None, pool):
        found.append(f"{held.field[0]}, the waters or the messy labs are others now")
    return found


def pool_digest(fish: Fish) -> str:
    """Digest of all that a comparison takes from the pool: its fish, waters and messy labs."""
    waters = (*ablations().values(), *ensemble(POOLS, ENSEMBLE_SEED))
    parts = (digest(fish), fingerprint(waters), mess.fingerprint())
    return hashlib.sha256("".join(parts).encode()).hexdigest()[:16]


def swim_cell(config: ComparisonConfig, policy: str, condition: str) -> Cell:
    """Swim a cell of `cells_of`."""
    field = field_of(config)
    (path,) = (name for name in config.policies if _label(name) == policy)
    entrant = _entrant(path, config.twin, field.fish)
    (own,) = (one for one in conditions_of(entrant, field) if one.name == condition)
    return cell(entrant, own, field)


def field_of(config: ComparisonConfig) -> Field:
    """The pool's fish and the targets of a comparison. Raises BadInput."""
    return Field(load_fish(config.fish), config.targets, config.seed)


def conclude(out: Path) -> Comparison:
    """The numbers of all cells in a folder; writes them into it."""
    found = read(out)
    write_json(out / "comparison.json", found, overwrite=True)
    return found


def _entrant(name: str, twin: str | None, fish: Fish) -> Entrant:
    policy = load_policy(name)
    return Entrant(_label(name), policy, check_swims(policy, twin, fish))


def _label(policy: str) -> str:
    """A policy's name: the run's folder if the file has the name that every run gives it; if that
    folder too has the name that a sweep or a zoo gives every run, the folder above it."""
    path = Path(policy).absolute()
    if path.name != "policy.onnx":
        return path.stem
    return path.parents[1].name if path.parent.name in ("run", "train") else path.parent.name


def conditions_of(entrant: Entrant, field: Field) -> list[Condition]:
    """The conditions: the twin, the pool, and the pool without one piece of physics at a time."""
    fish, n = field.fish, field.count
    contract = entrant.policy.contract
    space, m = contract.actions, contract.measure
    scene = grid(fish, n, field.seed, 0.5 * m.reach, 2.5 * m.reach, float(np.radians(120)))
    full = Condition("full", fish, scene, space, pools([ablations()["full"]], n), measure=m)
    full = as_seen(full, contract)
    own = fish.servos[fish.servo]
    prompt = own.model_copy(update={"delay": 0.0})
    twin = replace(full, name=TWIN, fish=entrant.twin, water=None)
    full = replace(full, corrections=contract.corrections)
    found = [twin, full]
    found += [
        replace(full, name=name, water=pools([water], n))
        for name, water in ablations().items()
        if name != "full"
    ]
    found.append(replace(full, name="no delay", servo=prompt))
    if IDEAL in fish.servos:
        found.append(replace(full, name="ideal servo", servo=fish.servos[IDEAL]))
    found.append(replace(full, name="ensemble", water=pools(ensemble(POOLS, ENSEMBLE_SEED), n)))
    return found + [
        at_level(replace(full, name=f"{name} labs"), name, field.seed) for name in MESSY
    ]


def cell(entrant: Entrant, condition: Condition, field: Field) -> Cell:
    """Swim one policy under one condition."""
    seeds = seeds_from(field.seed, condition.count)
    choose = partial(decide, entrant.policy)
    parts = [(part(condition, k), seeds[k * CHUNK :][:CHUNK]) for k in range(condition.chunks)]
    found = store.joined([swim(choose, own, some) for own, some in parts])
    contract = entrant.policy.contract
    power = power_shares(windows(found, surge(found), None), contract.band)
    return Cell(
        policy=entrant.name,
        actions=contract.actions.kind,
        servo=entrant.twin.servo,
        seed=contract.training.get("seed"),
        stage=contract.training.get("stage"),
        condition=condition.name,
        targets=condition.count,
        field=(field.fish.name, field.count, field.seed),
        digest=contract_digest(contract),
        pool=pool_digest(field.fish),
        **vars(success(found.reached, found.near)),
        speed=path_speed(found.pose),
        actuator_watts=actuator_watts(found),
        reversals_per_minute=reversals(found),
        share_below=power.share_below,
        share_below_floor=power.share_below_floor,
        share_inside=power.share_inside,
        share_above=power.share_above,
        speed_in_twin=None if condition.name == TWIN else replayed(found, entrant.twin),
        hits_arrived=tuple(found.reached.tolist()),
        hits_near=tuple(found.near.tolist()),
    )


def actuator_watts(found: Runs) -> float | None:
    """Mean power [W] of the actuator; None in a twin, which does not record it."""
    energy = np.asarray(found.energy, float)
    time = float(found.seconds.sum())
    return float(np.nansum(energy) / time) if np.isfinite(energy).any() else None


def reversals(found: Runs) -> float:
    """Changes between forward and backward, per minute."""
    signs = [np.sign(np.where(np.abs(row) < 0.02, np.nan, row)) for row in surge(found)]
    turns = sum(int((np.diff(one[np.isfinite(one)]) != 0).sum()) for one in signs)
    return 60 * turns / float(found.seconds.sum())


def path_speed(pose: Any) -> float:
    """Mean speed over ground [m/s] along paths (n, k, 3), NaN after their ends."""
    step = np.diff(pose[..., :2], axis=1)
    return float(np.nanmean(np.hypot(step[..., 0], step[..., 1])) / PERIOD)


def replayed(found: Runs, twin: Fish) -> float:
    """Mean speed [m/s] of the twin, without randomisation, with the setpoints of these swims."""
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
