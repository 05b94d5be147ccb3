"""Critics with normalised layers, which learn without target critics (CrossQ: Bhatt et al., ICLR
2024).

Every layer is followed by batch renormalisation (Ioffe, "Batch Renormalization", NeurIPS 2017).
Values now and ahead are computed in one pass, so both are normalised alike. The actor asks the
critics with the means and variances of many batches, which do not depend on its own.
"""

from typing import Any

import torch
from torch import nn
from torch.nn import functional

Tensor = torch.Tensor
WARM = 200  # passes of plain batch normalisation at first, until the kept means are worth something
MOMENTUM = 0.01  # of the kept means and variances
SCALE, SHIFT = 3.0, 5.0  # furthest that a batch may be from what is kept (CrossQ's)
SMALL = 1e-3
BETAS = 0.5, 0.999  # of Adam (CrossQ's)


class Renorm(nn.Module):
    """Batch renormalisation of (n, width). Called, it uses what is kept; `learning` uses the batch
    and remembers it, and `keep` then takes it up: in between, other threads may still ask."""

    mean: Tensor
    variance: Tensor
    passes: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.gain, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("variance", torch.ones(width))
        self.register_buffer("passes", torch.zeros(()))
        self.batch: tuple[Tensor, Tensor] | None = None

    def forward(self, x: Tensor) -> Tensor:
        """`x` (n, width) by the kept mean and variance."""
        kept = self.mean, self.variance
        return functional.batch_norm(x, *kept, self.gain, self.bias, eps=SMALL)

    def learning(self, x: Tensor) -> Tensor:
        """`x` (n, width) by its own mean and variance, brought near to what is kept."""
        with torch.no_grad():
            mean, variance = _statistics(x)
            own, kept = torch.sqrt(variance + SMALL), torch.sqrt(self.variance + SMALL)
            scale = (own / kept).clamp(1 / SCALE, SCALE)
            shift = ((mean - self.mean) / kept).clamp(-SHIFT, SHIFT)
            warm = self.passes > WARM  # no branch: a CUDA graph has none
            scale = torch.where(warm, scale, torch.ones_like(scale))
            shift = torch.where(warm, shift, torch.zeros_like(shift))
        self.batch = mean, variance
        gain, bias = scale * self.gain, shift * self.gain + self.bias
        return functional.batch_norm(x, None, None, gain, bias, training=True, eps=SMALL)

    def keep(self) -> None:
        """Take up the last batch: at first all batches alike, later the newest ones more."""
        assert self.batch is not None
        share = torch.clamp(1 / (self.passes + 1), min=MOMENTUM)
        for kept, new in zip((self.mean, self.variance), self.batch, strict=True):
            kept.lerp_(new, share)
        self.passes += 1


def _statistics(x: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance (width,) of `x` (n, width); a seventh of the time of torch.var_mean."""
    mean, variance = x.new_zeros(x.shape[1]), x.new_ones(x.shape[1])
    functional.batch_norm(x, mean, variance, training=True, momentum=1.0)
    return mean, variance * (1 - 1 / len(x))  # torch keeps the variance with n - 1


class Network(nn.Sequential):
    """A critic's layers."""

    def learning(self, x: Tensor) -> Tensor:
        """Values (n, 1), normalised by the batch."""
        for layer in self:
            x = layer.learning(x) if isinstance(layer, Renorm) else layer(x)
        return x


def network(inputs: int, width: int, depth: int) -> Network:
    """A critic of `depth` hidden layers from `inputs` to one value."""
    layers: list[nn.Module] = [Renorm(inputs)]
    for _ in range(depth):
        layers += [nn.Linear(inputs, width), nn.ReLU(), Renorm(width)]
        inputs = width
    return Network(*layers, nn.Linear(width, 1))


def put_into(model: Any) -> None:
    """Give a new model's critics normalised networks of the same sizes, and another optimiser. Its
    target critics stay as they are; nothing asks them."""
    critic = model.critic
    for k, net in enumerate(critic.q_networks):
        linear = [one for one in net if isinstance(one, nn.Linear)]
        new = network(linear[0].in_features, linear[0].out_features, len(linear) - 1)
        critic.q_networks[k] = new.to(model.device)
        setattr(critic, f"qf{k}", critic.q_networks[k])
    adam = critic.optimizer
    rate, fused = adam.param_groups[0]["lr"], adam.param_groups[0]["fused"]
    critic.optimizer = type(adam)(critic.parameters(), lr=rate, fused=fused, betas=BETAS)


def values(
    critic: Any, now: tuple[Tensor, Tensor], ahead: tuple[Tensor, Tensor]
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Values now and ahead, (n, 1) of each critic, from observations and actions, in one pass."""
    seen, done = (torch.cat(pair) for pair in zip(now, ahead, strict=True))
    with torch.no_grad():
        features = critic.extract_features(seen, critic.features_extractor)
    joint = torch.cat([features, done], dim=1)
    found, later = zip(*(net.learning(joint).chunk(2) for net in critic.q_networks), strict=True)
    return found, later


def keep(critic: Any) -> None:
    """Take up what the last pass through all layers has seen."""
    for layer in critic.modules():
        if isinstance(layer, Renorm):
            layer.keep()
