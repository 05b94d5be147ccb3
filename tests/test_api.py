"""The public names, and the environments as strangers use them: gymnasium, SB3's PPO, skrl's."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import gymnasium
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import tailbeat as tb

FISH = "pulley-fish-pool"
ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs" / "start" / "python.md"
NAMES = [name for name in tb.__all__ if name != "__version__"]


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    words = [sys.executable, "-c", code]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


# ---- names --------------------------------------------------------------------------------------


def test_importing_tailbeat_imports_nothing_else():
    loaded = set(python("import sys, tailbeat\nprint(*sys.modules)").split())
    rooms = {name for name in loaded if name.startswith("tailbeat.")}
    assert not rooms and not {"numpy", "gymnasium", "importlib.metadata"} & loaded
    others = {name.split(".")[0] for name in loaded} - set(sys.stdlib_module_names)
    others -= {"sitecustomize"}  # Debian's own Python begins with one
    assert {name for name in others if not name.startswith("_")} == {"tailbeat"}


def test_there_are_some_twenty_names_and_each_is_there_and_documented():
    assert 20 <= len(NAMES) <= 30
    text = DOCS.read_text(encoding="utf-8")
    for name in NAMES:
        assert getattr(tb, name).__doc__, name
        assert f"`{name}" in text, f"{name} is missing in {DOCS.name}"
    assert set(tb.__all__) <= set(dir(tb))


def test_type_checkers_are_told_the_same_names():
    """`make check` holds that each name's type is known, and that no other name is public."""
    held = (Path(__file__).parent / "public_names.py").read_text("utf-8")
    expected = re.findall(r"^    (\w+)\.nothing  # type: ignore", held, re.MULTILINE)
    assert sorted(expected) == sorted(["tb", *NAMES])
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    assert "tests" in tools["mypy"]["files"]


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nothing"):
        tb.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_a_name_whose_extra_is_missing_says_which_to_install():
    code = "import sys\nsys.modules['mujoco'] = None\nimport tailbeat as tb\ntry: tb.compile_twin"
    said = python(f"{code}\nexcept ModuleNotFoundError as error: print(error)")
    assert said == (
        "tailbeat.compile_twin needs the package mujoco: pip install 'tailbeat[sim]'.\n"
    )


def test_a_beat_swims_forward_in_the_twin():
    time = np.arange(0, 3, 0.02)
    beat = tb.Recording("beat", time, {"command_rad": 0.6 * np.sin(3 * np.pi * time)})
    swum = tb.simulate(tb.load_fish("pulley-fish"), beat)
    assert swum.time[-1] == pytest.approx(2.98) and swum.qpos[-1, 0] > 0.3
    with pytest.raises(tb.BadInput, match="command_rad is missing"):
        tb.simulate(tb.load_fish("pulley-fish"), tb.Recording("none", time, {}))


# ---- environments -------------------------------------------------------------------------------


def changed(before: list[torch.Tensor], model: torch.nn.Module) -> bool:
    """Whether training moved any weight."""
    return not all(torch.equal(*pair) for pair in zip(before, model.parameters(), strict=True))


@pytest.mark.parametrize("order", ["tailbeat, gymnasium", "gymnasium, tailbeat"])
def test_gymnasium_knows_the_environment_in_either_order_of_import(order):
    said = python(f"import {order}\nprint(gymnasium.spec('tailbeat/Reach-v0').id)")
    assert said == "tailbeat/Reach-v0\n"


@pytest.mark.thorough
def test_the_environment_passes_gymnasium_s_checker():
    env = gymnasium.make("tailbeat/Reach-v0", fish=FISH)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.unwrapped.world.fish == tb.load_fish(FISH)  # type: ignore[attr-defined]


def test_a_vector_of_fish_is_one_batch_and_each_swims_as_alone():
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 2, 6))
    many = gymnasium.make_vec("tailbeat/Reach-v0", num_envs=2, fish=tb.load_fish(FISH))
    assert isinstance(many.unwrapped, tb.FishVectorEnv)
    again = gymnasium.make_vec("tailbeat/Reach-v0", num_envs=2, fish=FISH)
    seen = [many.reset(seed=3)[0], again.reset(seed=3)[0]]
    for action in actions:
        seen = [env.step(action)[0] for env in (many, again)]
    assert np.array_equal(*seen)


@pytest.mark.thorough
def test_ppo_of_sb3_learns_on_it():
    env = make_vec_env("tailbeat/Reach-v0", n_envs=2, seed=0, env_kwargs={"fish": FISH})
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, device="cpu")
    before = [weights.detach().clone() for weights in model.policy.parameters()]
    model.learn(64)
    assert changed(before, model.policy)


def test_ppo_of_skrl_learns_on_it(tmp_path):
    pytest.importorskip("skrl", reason="the dev extra is not installed")
    from skrl.agents.torch.ppo import PPO as Agent
    from skrl.agents.torch.ppo import PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.trainers.torch import SequentialTrainer
    from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

    env = wrap_env(gymnasium.make_vec("tailbeat/Reach-v0", num_envs=4, fish=FISH), verbose=False)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    net = [{"name": "net", "input": "OBSERVATIONS", "layers": [16], "activations": "elu"}]
    models = {
        "policy": gaussian_model(**spaces, network=net, output="ACTIONS", clip_actions=True),
        "value": deterministic_model(**spaces, network=net, output="ONE"),
    }
    for model in models.values():
        model.init_state_dict()
    before = [weights.detach().clone() for weights in models["policy"].parameters()]
    quiet = {"directory": str(tmp_path), "write_interval": 0, "checkpoint_interval": 0}
    config = PPO_CFG(rollouts=8, learning_epochs=1, experiment=quiet)
    memory = RandomMemory(memory_size=8, num_envs=4)
    agent = Agent(models=models, memory=memory, **spaces, cfg=config)
    plan = {"timesteps": 24, "headless": True, "disable_progressbar": True}
    plan["close_environment_at_exit"] = False
    SequentialTrainer(env=env, agents=agent, cfg=plan).train()
    assert changed(before, models["policy"])
