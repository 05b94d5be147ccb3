"""A training's whole state on disk: networks, optimisers, entropy, buffer, curriculum, generators.

A checkpoint is a folder, written beside the last one and renamed. The last one is kept until then:
a run killed at any moment has a complete checkpoint, and at most two are on disk.
"""

import json
import os
import shutil
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC

from tailbeat.env.assess import Summary
from tailbeat.env.world import World
from tailbeat.files import BadInput, write_json
from tailbeat.train.progress import Progress, TrainingRow
from tailbeat.train.replay import EXTRA, RelabelBuffer

ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
FOLDERS = "checkpoint", "checkpoint.old"  # the newest first
LATER = ("went",)  # not in older checkpoints; where targets stay it counts for nothing
SPARE = 200e6  # bytes that are left free on the disk


@dataclass(frozen=True)
class Saved:
    """A checkpoint's counters: progress, decisions and updates so far, and the replay buffer's next
    row and whether it is full."""

    progress: Progress
    decisions: int
    updates: int
    buffer: tuple[int, bool]


def save(folder: Path, model: SAC, world: World, progress: Progress) -> None:
    """Write `checkpoint` into `folder`. Raises BadInput if the disk is full; the last one is then
    kept."""
    new, last, old = (folder / f"checkpoint{end}" for end in (".new", "", ".old"))
    buffer = model.replay_buffer
    assert buffer is not None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    needed = sum(getattr(buffer, name)[:filled].nbytes for name in _arrays(buffer)) + SPARE
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise BadInput(
            f"{folder}: {free / 1e6:.0f} MB free, a checkpoint needs {needed / 1e6:.0f} MB; free"
            f" space and continue with --resume (the last checkpoint is intact)."
        )
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    arrays = {name: getattr(buffer, name)[:filled] for name in _arrays(buffer)}
    np.savez(new / "buffer.npz", **arrays)
    torch.save(_learned(model), new / "networks.pt")
    place = buffer.pos, buffer.full
    counters = {"decisions": model.num_timesteps, "updates": model._n_updates, "buffer": place}
    write_json(new / "state.json", asdict(progress) | counters)
    write_json(new / "random.json", _random(world))
    if last.exists():  # if not, `old` is all that an earlier kill has left
        shutil.rmtree(old, ignore_errors=True)
        os.replace(last, old)
    os.replace(new, last)
    shutil.rmtree(old, ignore_errors=True)


def _arrays(buffer: Any) -> tuple[str, ...]:
    return ARRAYS + (EXTRA if isinstance(buffer, RelabelBuffer) else ())


def find(folder: Path) -> Path | None:
    """The newest complete checkpoint of a run; in its first minutes there is none."""
    complete = (folder / name for name in FOLDERS if (folder / name / "random.json").is_file())
    return next(complete, None)


def read_state(place: Path) -> Saved:
    """Read the counters of a checkpoint. Raises BadInput if they cannot be read."""
    try:
        held = json.loads((place / "state.json").read_text(encoding="utf-8"))
        progress = _progress(held)
        position, full = held["buffer"]
        return Saved(progress, held["decisions"], held["updates"], (position, full))
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(
            f"{place}/state.json: cannot be read; the checkpoint is damaged. Train again in another"
            f" folder."
        ) from None


def _progress(held: dict[str, Any]) -> Progress:
    names = [one.name for one in fields(Progress)]
    rows = {name: [_row(**one) for one in held[name]] for name in ("history", "promotions")}
    recent = [(begun, arrived) for begun, arrived in held["recent"]]
    later = {"leapt": None, "passed_at": None}  # not in older checkpoints
    known = later | {name: held[name] for name in names if name in held or name not in later}
    return Progress(**known | rows | {"recent": recent})


def _row(greedy: dict[str, Any] | None = None, **rest: Any) -> TrainingRow:
    return TrainingRow(**rest, greedy=None if greedy is None else Summary(**greedy))


def load(place: Path, model: SAC, world: World) -> Saved:
    """Load a checkpoint into a new model and world; returns its counters. Raises BadInput."""
    state = read_state(place)
    try:
        _load(place, model, world, state)
    except BadInput:
        raise
    except Exception as error:  # damaged bytes make torch, numpy and zipfile raise a dozen kinds
        raise BadInput(
            f"{place}: cannot be read ({type(error).__name__}); the checkpoint is damaged. Train"
            f" again in another folder."
        ) from error
    return state


def load_networks(folder: Path, model: SAC) -> None:
    """Load what the run in `folder` has learnt into a new model: networks, optimisers, entropy;
    not its buffer, whose swims may be another fish's. Raises BadInput."""
    place = find(folder)
    if place is None:
        raise BadInput(
            f"{folder}: no checkpoint to start from; give the folder of a run of `tailbeat train`."
        )
    try:
        _learn_again(model, torch.load(place / "networks.pt", "cpu", weights_only=True))
    except Exception as error:  # of torch: shapes, parameter groups, a broken archive
        raise BadInput(
            f"{place}/networks.pt: these networks do not fit this run (observed numbers, actions,"
            f" width), or are damaged; start from a run with the same options."
        ) from error


def _learn_again(model: SAC, learned: dict[str, Any]) -> None:
    model.policy.load_state_dict(learned["policy"])
    for name, optimizer in _optimizers(model).items():
        optimizer.load_state_dict(learned[name])
    if model.log_ent_coef is not None:
        model.log_ent_coef.data = learned["log_ent_coef"].to(model.device)


def _load(place: Path, model: SAC, world: World, state: Saved) -> None:
    buffer = model.replay_buffer
    assert buffer is not None
    with np.load(place / "buffer.npz") as arrays:
        for name in _arrays(buffer):
            if name in LATER and name not in arrays:
                _check_stays(place, name, world)
                continue
            getattr(buffer, name)[: len(arrays[name])] = arrays[name]
    if isinstance(buffer, RelabelBuffer):
        buffer.begin_after(int(buffer.episode.max()))
    buffer.pos, buffer.full = state.buffer
    learned = torch.load(place / "networks.pt", map_location="cpu", weights_only=True)
    _learn_again(model, learned)
    torch.set_rng_state(learned["torch"])
    _restore(json.loads((place / "random.json").read_text(encoding="utf-8")), world)


def _check_stays(place: Path, name: str, world: World) -> None:
    """Check that targets stay, so that rewards need no `name`. Raises BadInput."""
    if world.task.follow:
        raise BadInput(
            f"{place}/buffer.npz: lacks {name}; it was written before the reward of following"
            f" counted velocities. Train again in another folder."
        )


def _optimizers(model: SAC) -> dict[str, Any]:
    found = {"actor": model.actor.optimizer, "critic": model.critic.optimizer}
    if model.ent_coef_optimizer is not None:
        found["entropy"] = model.ent_coef_optimizer
    return found


def _learned(model: SAC) -> dict[str, Any]:
    found = {name: one.state_dict() for name, one in _optimizers(model).items()}
    found |= {"policy": model.policy.state_dict(), "torch": torch.get_rng_state()}
    if model.log_ent_coef is not None:
        found["log_ent_coef"] = model.log_ent_coef.data
    return found


def _random(world: World) -> dict[str, Any]:
    """States of the fish's generators, and of numpy's global one, from which SB3 draws its
    batches."""
    kind, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002 (SB3 draws from it)
    return {"fish": [rng.bit_generator.state for rng in world.rngs], "numpy": [kind, keys, *rest]}


def _restore(states: dict[str, Any], world: World) -> None:
    for rng, state in zip(world.rngs, states["fish"], strict=True):
        rng.bit_generator.state = state
    kind, keys, *rest = states["numpy"]
    np.random.set_state((kind, np.array(keys, dtype=np.uint32), *rest))  # noqa: NPY002
