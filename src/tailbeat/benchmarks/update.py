"""Speed of a training update, compared with SB3's own SAC in one run.

Needs the train extra. Networks, batch and swims are the same; the updates are timed in turns.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

from tailbeat.fish.store import load_fish
from tailbeat.train.config import RunConfig
from tailbeat.train.recipes import Recipe, paper, quick
from tailbeat.train.sac import rounds
from tailbeat.train.spaces import action_space
from tailbeat.train.train import environment, learner

FISH = "pulley-fish-pool"
STEPS = 100  # control steps of every fish, at random, that fill the buffer
UPDATES = 50  # per turn
TURNS = 7


@dataclass(frozen=True)
class UpdateRow:
    """A training `update` by name: its batch, its time [ms], and SB3's time over it."""

    update: str
    batch: int
    ms: float
    of_sb3: float


def update_bench() -> tuple[UpdateRow, ...]:
    """Measure the time per update, median of the turns, compared with SB3's SAC of the recipe
    `paper` with torch's own threads. Ours is timed with SB3's losses and with normalised critics,
    each with and without rounded products."""
    threads = torch.get_num_threads()
    ours = {"quick": replace(quick(), normalised=False), "normalised": quick()}
    recipes = {"SB3's SAC": paper()}
    for name, recipe in ours.items():
        recipes[f"{name}, float32"] = replace(recipe, rounded=False)
        if rounds():
            recipes[f"{name}, rounded"] = recipe
    models = {name: _filled(recipe) for name, recipe in recipes.items()}
    spent: dict[str, list[float]] = {name: [] for name in models}
    try:
        for _ in range(TURNS):
            for name, model in models.items():
                torch.set_num_threads(recipes[name].torch_threads or threads)
                spent[name].append(_turn(model, recipes[name].batch))
    finally:
        torch.set_num_threads(threads)
    theirs = float(np.median(spent["SB3's SAC"]))
    medians = {name: float(np.median(times)) for name, times in spent.items()}
    return tuple(
        UpdateRow(name, recipes[name].batch, 1e3 * seconds, theirs / seconds)
        for name, seconds in medians.items()
    )


def _filled(recipe: Recipe) -> SAC:
    """An untrained learner with some swims in its buffer."""
    fish = load_fish(FISH)
    steps = STEPS * recipe.fish
    small = replace(recipe, buffer=2 * steps, starts=2 * steps)
    run = RunConfig(fish, Path(), small, action_space("generator", fish))
    model = learner(run, environment(run))
    model.set_logger(configure(None, []))
    return model.learn(steps, log_interval=steps)


def _turn(model: SAC, batch: int) -> float:
    """Time per update [s]; a few updates before are not counted."""
    model.train(UPDATES // 10, batch)
    began = time.perf_counter()
    model.train(UPDATES, batch)
    return (time.perf_counter() - began) / UPDATES
