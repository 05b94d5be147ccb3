"""The environments for `gymnasium.make("tailbeat/Reach-v0", fish=…)`."""

from pathlib import Path

from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishEnv, FishVectorEnv
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish

FISH = "pulley-fish-pool"


def reach(
    fish: Fish | str | Path = FISH,
    settings: Settings | None = None,
    seed: int | None = None,
    render_mode: str | None = None,
) -> FishEnv:
    """One fish and its target. `fish` is a description, a TOML file or a shipped fish's name."""
    return FishEnv(_described(fish), settings, seed, render_mode)


def reach_vector(
    num_envs: int,
    fish: Fish | str | Path = FISH,
    settings: Settings | None = None,
    seed: int | None = None,
    threads: int = 0,
) -> FishVectorEnv:
    """`num_envs` fish in one batch; `threads` 0 means every core."""
    return FishVectorEnv(_described(fish), num_envs, settings, seed, threads)


def _described(fish: Fish | str | Path) -> Fish:
    return fish if isinstance(fish, Fish) else load_fish(fish)
