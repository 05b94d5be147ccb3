"""Your own reward, the way towards the target, and your own algorithm: a linear policy searched in
random directions (Mania et al. 2018), with one fish of the batch for each.

python examples/own_reward.py [--rounds 16]

round   0:   58.5 cm nearer in 5 s
round  14:  168.1 cm nearer in 5 s
"""

import argparse

import gymnasium
import numpy as np

import tailbeat as tb

DIRECTIONS, STEPS = 32, 250  # random directions of a round; 5 s of swimming
SIZE, RATE = 0.3, 1.5  # of a direction, of an update


class Approach(gymnasium.vector.VectorWrapper):
    """Pays the way made towards the target in a step [cm], instead of the paper's reward."""

    def step(self, actions):
        """As gymnasium's; the term `distance` is minus the distance [m]."""
        seen, _, ended, cut, info = self.env.step(actions)
        before, self.before = self.before, info["reward_terms"]["distance"]
        return seen, 100 * (self.before - before), ended, cut, info


def returns(env, weights, seed):
    """What each fish earns by its own linear policy (n, 6, 24) until its first end."""
    (seen, _), env.before = env.reset(seed=seed), -np.inf
    total, going = 0.0, np.ones(env.num_envs, bool)
    for _ in range(STEPS):
        actions = np.tanh(np.einsum("nij,nj->ni", weights, seen))
        seen, reward, ended, cut, _ = env.step(actions)
        going &= ~(ended | cut)
        total = total + np.where(going & np.isfinite(reward), reward, 0.0)
    return total


def main() -> None:
    """Search, and print what the batch earned in each round."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--rounds", type=int, default=16)
    settings = tb.Settings(task=tb.Task(nearest=2.0, farthest=2.0, arc=np.pi / 8))  # 2 m ahead
    env = Approach(gymnasium.make_vec("tailbeat/Reach-v0", 2 * DIRECTIONS, settings=settings))
    mean, rng = np.zeros((6, 24)), np.random.default_rng(0)
    for number in range(parser.parse_args().rounds):
        noise = SIZE * rng.normal(size=(DIRECTIONS, 6, 24))
        earned = returns(env, mean + np.concatenate([noise, -noise]), number)
        gain = (earned[:DIRECTIONS] - earned[DIRECTIONS:]) / (earned.std() + 1e-9)
        mean = mean + RATE * np.einsum("n,nij->ij", gain, noise) / DIRECTIONS
        print(f"round {number:3d}: {earned.mean():6.1f} cm nearer in 5 s")


if __name__ == "__main__":
    main()
