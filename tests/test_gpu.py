"""Updates and trainings on a GPU (`pytest -m gpu`), held to those of a processor."""

from dataclasses import replace

import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import numpy as np
import torch
from stable_baselines3.common.utils import FloatSchedule

from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.fish.store import load_fish
from tailbeat.train.captured import WARM
from tailbeat.train.config import RunConfig
from tailbeat.train.recipes import smoke
from tailbeat.train.sac import QuickSAC
from tailbeat.train.train import train

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA device"),
]
FISH = load_fish("pulley-fish-pool")
STILL = Settings(sensors=quiet(), physics=randomize.none())


def filled(device: str, normalised: bool = False) -> QuickSAC:
    """A learner that has swum and not learnt: the same weights and buffer on every device."""
    env = FishVecEnv(FISH, 8, STILL, seed=0, reward_scale=0.01)
    model = QuickSAC(
        "MlpPolicy", env, learning_starts=1_000, batch_size=64, seed=0, device=device, tau=0.01,
        normalised=normalised,
    )  # fmt: skip
    model.learn(800)
    torch.manual_seed(5)
    return model


def weights(model: QuickSAC) -> torch.Tensor:
    assert model.log_ent_coef is not None
    held = [*model.actor.parameters(), *model.critic.parameters(), model.log_ent_coef]
    held += list(model.critic_target.parameters())
    return torch.cat([one.detach().cpu().ravel() for one in held])


def updated(device: str, rates: tuple[float, ...], normalised: bool = False) -> QuickSAC:
    """A learner after one update at each rate, of equal batches and noise."""
    model = filled(device, normalised)
    np.random.seed(3)  # noqa: NPY002 (SB3 draws from it)
    for rate in rates:
        model.lr_schedule = FloatSchedule(rate)
        model.train(1, 64)
    return model


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("count", [1, WARM + 1, 40])
def test_updates_are_those_of_a_processor(count, normalised):
    """One kernel after another, the first that is captured, and many."""
    start = weights(filled("cpu", normalised))
    rates = (3e-4,) * count
    ours, theirs = (weights(updated(device, rates, normalised)) for device in ("cuda", "cpu"))
    assert (theirs - start).norm() > 0
    assert (ours - theirs).norm() < 0.02 * (theirs - start).norm()


def test_a_captured_update_reads_the_rate_anew():
    def actor(*more: float) -> torch.Tensor:
        model = updated("cuda", (3e-4,) * (WARM + 2) + more)
        return torch.cat([one.detach().ravel() for one in model.actor.parameters()])

    assert torch.allclose(actor(0.0), actor(), atol=1e-6)
    assert not torch.allclose(actor(3e-4), actor(), atol=1e-6)


@pytest.mark.parametrize("then", ["cuda", "cpu"])
def test_a_training_is_continued_on_either_device(tmp_path, then):
    run = RunConfig(FISH, tmp_path / "run", smoke(), seed=0, hours=20 / 3600, device="cuda")
    first = train(run)
    again = train(replace(run, device=then), resume=True, stage=run.recipe.stages[0].name)
    assert 0 < first.history[-1].updates < again.history[-1].updates
