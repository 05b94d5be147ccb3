"""One update of the learner, against stable-baselines3: losses, gradients, seeds."""

from typing import Any

import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import torch

from tailbeat.benchmarks import update as update_bench
from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.fish.store import load_fish
from tailbeat.train import config as config
from tailbeat.train.sac import QuickSAC, _products, rounds

FISH = load_fish("pulley-fish-pool")
STILL = Settings(sensors=quiet(), physics=randomize.none())


@pytest.fixture(scope="module")
def learner() -> QuickSAC:
    env = FishVecEnv(FISH, 8, STILL, seed=0, reward_scale=0.01)
    model = QuickSAC(
        "MlpPolicy", env, learning_starts=64, batch_size=32, train_freq=1, seed=0, device="cpu"
    )
    return model.learn(400)


def test_squashed_actions_have_sb3_s_probability(learner):
    seen = torch.as_tensor(learner.replay_buffer.observations[:20, 0])
    action, log_prob = learner._act(seen, torch.randn(20, 6))
    mean, log_std, _ = learner.actor.get_action_dist_params(seen)
    theirs = learner.actor.action_dist.proba_distribution(mean, log_std).log_prob(action)
    assert log_prob[:, 0].detach().numpy() == pytest.approx(theirs.detach().numpy(), abs=2e-3)


def test_the_critics_gradient_is_that_of_sb3_s_loss(learner):
    data, noise = learner._batch(32), torch.randn(32, 6)
    entropy = torch.tensor([0.1])
    _, gradient = learner._critic_gradient(data, noise, entropy)
    with torch.no_grad():
        action, log_prob = learner._act(data.next_observations, noise)
        both = torch.cat(learner.critic_target(data.next_observations, action), dim=1)
        value = both.min(dim=1, keepdim=True)[0] - entropy * log_prob
        goal = data.rewards + (1 - data.dones) * learner.gamma * value
    learner.critic.optimizer.zero_grad()
    found = learner.critic(data.observations, data.actions)
    losses = [torch.nn.functional.mse_loss(q, goal) for q in found]
    (0.5 * torch.stack(losses).sum()).backward()
    for slope, parameter in zip(gradient, learner.critic.parameters(), strict=True):
        assert torch.allclose(slope, parameter.grad, atol=1e-6)


def test_what_lies_behind_an_end_is_worth_nothing(learner):
    """At an arrival the critics learn the reward alone, whatever comes next."""
    data, noise = learner._batch(32), torch.randn(32, 6)
    ended = data._replace(dones=torch.ones_like(data.dones))
    elsewhere = ended._replace(next_observations=torch.randn_like(data.next_observations))
    loss, _ = learner._critic_gradient(ended, noise, torch.tensor([0.1]))
    assert torch.equal(loss, learner._critic_gradient(elsewhere, noise, torch.tensor([0.1]))[0])
    found = learner.critic(data.observations, data.actions)
    both = [torch.nn.functional.mse_loss(q, data.rewards).item() for q in found]
    assert loss.item() == pytest.approx(0.5 * sum(both), rel=1e-5)


def test_optimisers_of_a_gpu_s_checkpoint_go_on_here(learner):
    """There the rate is a tensor and a step may be captured; here neither is allowed."""
    optimizers = learner.actor.optimizer, learner.critic.optimizer, learner.ent_coef_optimizer
    for group in (one.param_groups[0] for one in optimizers):
        group["lr"], group["capturable"] = torch.tensor(1e-3), True
    before = learner.log_ent_coef.detach().clone()
    learner.train(2, 32)
    assert not torch.equal(learner.log_ent_coef, before)
    assert all(isinstance(one.param_groups[0]["lr"], float) for one in optimizers)


@pytest.mark.thorough
def test_updates_are_measured_against_sb3_s_of_the_same_size(monkeypatch):
    for name, few in (("STEPS", 20), ("UPDATES", 10), ("TURNS", 1)):
        monkeypatch.setattr(update_bench, name, few)
    threads = torch.get_num_threads()
    rows = update_bench.update_bench()
    assert rows[0].of_sb3 == 1.0
    assert len({row.batch for row in rows}) == 1
    assert all(row.ms * row.of_sb3 == pytest.approx(rows[0].ms) for row in rows)
    assert torch.get_num_threads() == threads


@pytest.mark.skipif(not rounds(), reason="this processor does not multiply bfloat16")
def test_rounded_products_leave_the_gradient_s_direction_and_end_with_the_update(learner):
    data, noise = learner._batch(256), torch.randn(256, 6)
    entropy = torch.tensor([0.1])

    def slope() -> torch.Tensor:
        return torch.cat([g.ravel() for g in learner._critic_gradient(data, noise, entropy)[1]])

    exact = slope()
    with _products(True):
        rounded = slope()
    assert not torch.equal(rounded, exact)
    assert torch.cosine_similarity(rounded, exact, dim=0) > 0.999
    assert torch.equal(slope(), exact)
    with _products(False):
        assert torch.equal(slope(), exact)


def test_a_seed_gives_one_run():
    def trained() -> Any:
        env = FishVecEnv(FISH, 4, STILL, seed=1)
        model = QuickSAC("MlpPolicy", env, learning_starts=32, batch_size=16, seed=7, device="cpu")
        return model.learn(200).policy.state_dict()

    one, two = trained(), trained()
    assert all(torch.equal(one[name], two[name]) for name in one)
