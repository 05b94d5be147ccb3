"""SB3's SAC with its update rearranged for two cores: the same losses in half the time.

Critics and actor compute their gradients at the same time, each on its own thread, from the same
parameters; in SB3 the actor uses the critics one step later. Samples, noise and steps are drawn in
one thread, so a seed gives one run. On a GPU the whole update is one CUDA graph. The exploration
noise is correlated in time: with white noise at 50 decisions a second, the generator's lag would
average it out (after Eberhard et al., "Pink Noise Is All You Need", ICLR 2023; first order here).
Everything else is `stable_baselines3.SAC`.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.utils import polyak_update
from torch.nn import functional

from tailbeat.train import normalised
from tailbeat.train.captured import Captured

Tensor = torch.Tensor
BESIDE = ThreadPoolExecutor(1)  # kept, since a new thread per call halves the update rate
LOG_TWO_PI = float(np.log(2 * np.pi))
SMALL = 1e-6  # keeps the squash's log finite, as in SB3


class QuickSAC(SAC):
    """SAC with critics and actor updated in parallel.

    Takes SAC's arguments. `memory` is the correlation of the exploration noise from one control
    step to the next. One that is `taught` by another run explores with its policy from the start,
    not at random. `rounded` updates multiply matrices in bfloat16 if the processor supports
    it, on a GPU in TF32. `normalised` critics (`normalised.py`) need no targets.
    """

    def __init__(
        self,
        *args: Any,
        memory: float = 0.0,
        rounded: bool = False,
        normalised: bool = False,
        taught: bool = False,
        **rest: Any,
    ) -> None:
        self.memory, self.rounded, self.normalised = memory, rounded, normalised
        self.taught = taught
        super().__init__(*args, **rest)

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.normalised:
            normalised.put_into(self)
        self.noise = torch.randn((self.n_envs, *(self.action_space.shape or ())))
        self.on_gpu = self.device.type == "cuda"
        self.rounded = self.rounded and (self.on_gpu or rounds())
        self.rate = torch.zeros((), device=self.device)
        self.captured = Captured(self._learn_from) if self.on_gpu else None

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "captured"]

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[Any, Any]:
        """Exploration actions (n, size): uniform before learning starts, unless it is taught; then
        from the policy's distribution with correlated noise."""
        fresh = torch.randn(self.noise.shape)
        self.noise = self.memory * self.noise + (1 - self.memory**2) ** 0.5 * fresh
        if self.num_timesteps < learning_starts and not self.taught:
            action = torch.erf(self.noise / 2**0.5)
        else:
            seen = torch.as_tensor(self._last_obs, device=self.device)
            with torch.no_grad():
                action = self._act(seen, self.noise.to(self.device))[0].cpu()
        return action.numpy(), action.numpy()

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates; called by `learn`."""
        self.policy.set_training_mode(True)
        if self.ent_coef_optimizer is None or self.log_ent_coef is None:
            raise ValueError("QuickSAC learns its entropy coefficient: give ent_coef='auto'.")
        optimizers = [self.actor.optimizer, self.critic.optimizer, self.ent_coef_optimizer]
        self._update_learning_rate(optimizers)
        with _products(self.rounded):
            losses = [self._update(batch_size) for _ in range(gradient_steps)]
        self._n_updates += gradient_steps
        self._record(torch.stack(losses).mean(dim=0).tolist())

    def _update_learning_rate(self, optimizers: Any) -> None:
        """SB3's; on a GPU the rate becomes a tensor, since a captured update reads no number anew.
        A checkpoint may be of the other kind of device, so its steps are moved too."""
        super()._update_learning_rate(optimizers)
        for optimizer in optimizers:
            for group in optimizer.param_groups:
                group["capturable"] = self.on_gpu
                if self.on_gpu:
                    group["lr"] = self.rate.fill_(group["lr"])
            for state in optimizer.state.values():
                state["step"] = state["step"].to(self.device)

    def _update(self, batch_size: int) -> Tensor:
        """One update; returns the losses of critic and actor, and the entropy coefficient (3,)."""
        data = self._batch(batch_size)
        # drawn by the processor, whose state a checkpoint holds
        noise = torch.randn((2, *data.actions.shape)).to(self.device)
        return (self.captured or self._learn_from)(*data, noise)

    def _batch(self, size: int) -> Any:
        """A batch from the buffer, with the discount of every transition."""
        assert self.replay_buffer is not None
        data = self.replay_buffer.sample(size, env=self._vec_normalize_env)
        if data.discounts is None:
            data = data._replace(discounts=torch.full_like(data.rewards, self.gamma))
        return data

    def _learn_from(self, *batch: Tensor) -> Tensor:
        """Step all optimisers once, from the fields of `ReplayBufferSamples` and the noise of both
        actions (2, n, size)."""
        assert self.log_ent_coef is not None
        data, noise = ReplayBufferSamples(*batch[:-1]), batch[-1]
        entropy = torch.exp(self.log_ent_coef.detach())
        critic, actor = self._gradients(data, noise, entropy)
        (critic_loss, critic_gradient), (actor_loss, log_prob, actor_gradient) = critic, actor
        _step(self.critic.optimizer, list(self.critic.parameters()), critic_gradient)
        _step(self.actor.optimizer, list(self.actor.parameters()), actor_gradient)
        missing = (log_prob + self.target_entropy).mean()
        _step(self.ent_coef_optimizer, [self.log_ent_coef], [-missing.reshape(1)])
        if self.normalised:
            normalised.keep(self.critic)
        else:
            polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
        return torch.stack([critic_loss, actor_loss, entropy.reshape(())])

    def _gradients(self, data: Any, noise: Tensor, entropy: Tensor) -> tuple[Any, Any]:
        """What `_critic_gradient` and `_actor_gradient` return; at the same time on a processor."""
        if self.on_gpu:
            critic = self._critic_gradient(data, noise[0], entropy)
            return critic, self._actor_gradient(data, noise[1], entropy)
        waiting = BESIDE.submit(self._critic_gradient, data, noise[0], entropy)
        actor = self._actor_gradient(data, noise[1], entropy)
        return waiting.result(), actor

    def _critic_gradient(self, data: Any, noise: Tensor, entropy: Tensor) -> tuple[Tensor, Any]:
        with torch.no_grad():
            action, log_prob = self._act(data.next_observations, noise)
        found, ahead = self._values(data, action)
        with torch.no_grad():
            value = torch.cat(ahead, dim=1).min(dim=1, keepdim=True).values - entropy * log_prob
            goal = data.rewards + (1 - data.dones) * data.discounts * value
        loss = 0.5 * torch.stack([functional.mse_loss(q, goal) for q in found]).sum()
        return loss.detach(), torch.autograd.grad(loss, list(self.critic.parameters()))

    def _values(self, data: Any, action: Tensor) -> tuple[Any, Any]:
        """Each critic's values (n, 1) of a batch, and those ahead, of its next observations with
        `action`."""
        now, next_one = (data.observations, data.actions), (data.next_observations, action)
        if self.normalised:
            return normalised.values(self.critic, now, next_one)
        with torch.no_grad():
            ahead = self.critic_target(*next_one)
        return self.critic(*now), ahead

    def _actor_gradient(self, data: Any, noise: Tensor, entropy: Tensor) -> tuple[Tensor, Any, Any]:
        action, log_prob = self._act(data.observations, noise)
        value = torch.cat(self.critic(data.observations, action), dim=1)
        loss = (entropy * log_prob - value.min(dim=1, keepdim=True).values).mean()
        gradient = torch.autograd.grad(loss, list(self.actor.parameters()))
        return loss.detach(), log_prob.detach(), gradient

    def _act(self, observations: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Squashed actions (n, size) and their log-probability (n, 1), computed with given
        noise."""
        mean, log_std, _ = self.actor.get_action_dist_params(observations)
        action = torch.tanh(mean + log_std.exp() * noise)
        normal = -0.5 * (noise.square() + LOG_TWO_PI) - log_std
        return action, (normal - torch.log(1 - action.square() + SMALL)).sum(dim=1, keepdim=True)

    def _record(self, means: Any) -> None:
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        names = ("critic_loss", "actor_loss", "ent_coef")
        for name, value in zip(names, means, strict=True):
            self.logger.record(f"train/{name}", float(value))


def rounds() -> bool:
    """Whether this processor multiplies bfloat16 in hardware (AMX or AVX-512 BF16)."""
    can = torch.cpu.get_capabilities()
    return bool(can.get("amx_bf16") or can.get("avx512_bf16"))


@contextmanager
def _products(rounded: bool) -> Iterator[None]:
    """Inside, multiply matrices in bfloat16 with float32 sums, if `rounded`. Decisions and exported
    networks stay float32."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if rounded else before)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def _step(optimizer: Any, parameters: list[Any], gradient: Any) -> None:
    for parameter, slope in zip(parameters, gradient, strict=True):
        parameter.grad = slope
    optimizer.step()
