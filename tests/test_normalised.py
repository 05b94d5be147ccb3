"""Critics with normalised layers, against torch's batch normalisation and the formula; learning
without targets; checkpoints."""

from typing import Any

import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import torch

from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.train import checkpoint
from tailbeat.train.normalised import MOMENTUM, SCALE, SHIFT, SMALL, WARM, Renorm
from tailbeat.train.progress import Progress
from tailbeat.train.sac import QuickSAC

FISH = load_fish("pulley-fish-pool")
STILL = Settings(sensors=quiet(), physics=randomize.none())
WIDTH = 5


def seen(count: int, seed: int) -> torch.Tensor:
    made = torch.Generator().manual_seed(seed)
    return 3.0 * torch.randn(count, WIDTH, generator=made) + torch.arange(WIDTH)


def used(passes: int) -> Renorm:
    layer = Renorm(WIDTH)
    with torch.no_grad():
        layer.gain.copy_(torch.linspace(0.5, 2.0, WIDTH))
        layer.bias.copy_(torch.linspace(-1.0, 1.0, WIDTH))
        for k in range(passes):
            layer.learning(seen(64, k))
            layer.keep()
    return layer


@pytest.mark.parametrize("passes", [0, WARM // 2])
def test_at_first_a_layer_is_torch_s_batch_normalisation(passes):
    layer, theirs = used(passes), torch.nn.BatchNorm1d(WIDTH, eps=SMALL)
    theirs.load_state_dict({"weight": layer.gain, "bias": layer.bias}, strict=False)
    batch = seen(200, 1000).requires_grad_()
    weight = torch.randn(200, WIDTH)
    found, wanted = layer.learning(batch), theirs(batch)
    assert torch.allclose(found, wanted, atol=1e-5)
    slope, other = (torch.autograd.grad((one * weight).sum(), batch)[0] for one in (found, wanted))
    assert torch.allclose(slope, other, atol=1e-4)


def test_later_it_is_normalised_by_what_is_kept_unless_a_batch_is_too_far():
    layer = used(WARM + 1)
    batch = seen(64, 1000)
    assert torch.allclose(layer.learning(batch), layer(batch), atol=1e-5)
    far = 40.0 * batch
    mean, std = far.mean(dim=0), torch.sqrt(far.var(dim=0, unbiased=False) + SMALL)
    kept = torch.sqrt(layer.variance + SMALL)
    shift = ((mean - layer.mean) / kept).clamp(-SHIFT, SHIFT)
    by_hand = ((far - mean) / std * SCALE + shift) * layer.gain + layer.bias
    assert torch.allclose(layer.learning(far), by_hand, atol=1e-4)
    assert not torch.allclose(layer.learning(far), layer(far), atol=1.0)


def test_what_is_kept_is_the_mean_of_all_batches_and_forgets_them_later():
    layer = used(50)
    batches = torch.stack([seen(64, k) for k in range(50)])
    assert torch.allclose(layer.mean, batches.mean(dim=(0, 1)), atol=1e-5)
    spread = batches.var(dim=1, unbiased=False).mean(dim=0)
    assert torch.allclose(layer.variance, spread, rtol=1e-4)
    late = used(round(2 / MOMENTUM))
    before = late.mean.clone()
    late.learning(torch.full((8, WIDTH), 100.0))
    late.keep()
    assert torch.allclose(late.mean, before + MOMENTUM * (100.0 - before), rtol=1e-5)


def learner(normalised: bool, seed: int = 7) -> QuickSAC:
    env = FishVecEnv(FISH, 4, STILL, seed=1, reward_scale=0.01)
    return QuickSAC(
        "MlpPolicy", env, learning_starts=32, batch_size=16, seed=seed, device="cpu",
        normalised=normalised, policy_kwargs={"net_arch": [32, 32]},
    )  # fmt: skip


def without_targets(normalised: bool) -> QuickSAC:
    model = learner(normalised)
    with torch.no_grad():
        for one in model.critic_target.parameters():
            one.fill_(float("nan"))
    return model.learn(80)


def test_normalised_critics_ask_no_targets():
    asked, unasked = learner(True).learn(80), without_targets(True)
    pairs = zip(asked.critic.parameters(), unasked.critic.parameters(), strict=True)
    assert all(torch.equal(one, other) for one, other in pairs) and unasked._n_updates > 5
    with pytest.raises(BadInput, match="give finite numbers"):  # of the actor, soon after
        without_targets(False)


def test_the_critics_gradient_is_that_of_both_batches_in_one_pass():
    model = learner(True).learn(60)
    data, noise = model._batch(16), torch.randn(16, 6)
    loss, gradient = model._critic_gradient(data, noise, torch.tensor([0.1]))
    with torch.no_grad():
        action, log_prob = model._act(data.next_observations, noise)
    both = torch.cat([data.observations, data.next_observations])
    joint = torch.cat([both, torch.cat([data.actions, action])], dim=1)
    networks: Any = model.critic.q_networks
    found = [net.learning(joint) for net in networks]
    ahead = torch.minimum(*(one[16:].detach() for one in found)) - 0.1 * log_prob
    goal = data.rewards + (1 - data.dones) * model.gamma * ahead
    losses = [torch.nn.functional.mse_loss(one[:16], goal) for one in found]
    by_hand = 0.5 * torch.stack(losses).sum()
    assert loss.item() == pytest.approx(by_hand.item(), rel=1e-5)
    slopes = torch.autograd.grad(by_hand, list(model.critic.parameters()))
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(gradient, slopes, strict=True))


def test_a_seed_gives_one_run_and_a_checkpoint_keeps_what_is_kept(tmp_path):
    one, two = learner(True).learn(80), learner(True).learn(80)
    first, second = one.policy.state_dict(), two.policy.state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert first["critic.qf0.0.passes"] == one._n_updates
    checkpoint.save(tmp_path, one, world(one), Progress())
    fresh = learner(True, seed=8)
    checkpoint.load(tmp_path / "checkpoint", fresh, world(fresh))
    later = fresh.policy.state_dict()
    assert all(torch.equal(first[name], later[name]) for name in first)


def world(model: QuickSAC) -> Any:
    env: Any = model.env
    return env.world
