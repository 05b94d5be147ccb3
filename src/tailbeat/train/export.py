"""Export SB3's actor to a policy file: the network in ONNX, with its contract."""

import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from stable_baselines3 import SAC

from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import table
from tailbeat.control.policy import KEY, Contract, Policy, as_text, load_policy
from tailbeat.files import new_file
from tailbeat.fish.store import digest
from tailbeat.train.config import RunConfig
from tailbeat.train.features import TargetFeatures

Single = NDArray[np.float32]
Facts = Mapping[str, str | int | float]
GOLDEN = 16  # pairs
OPSET, IR = 20, 10  # versions that onnxruntime 1.31 and the one on a Raspberry Pi read
PRODUCED_BY = ("tailbeat", "mujoco", "torch", "stable-baselines3")


def export(model: SAC, run: RunConfig, seen: Single, training: Facts, path: Path) -> Policy:
    """Write a run's policy, read it back and check its golden pairs.

    `seen` (k, observed) are observations of real swims, from which the golden ones are taken.
    `training` says how the policy was trained. Raises BadInput.
    """
    golden = seen[np.linspace(0, len(seen) - 1, GOLDEN).astype(int)]
    contract = contract_of(run, golden, act(model, golden), training)
    return save(as_onnx(model, contract), path)


def contract_of(run: RunConfig, seen: Single, actions: Single, training: Facts) -> Contract:
    """The contract of a run's policy, with golden observations (k, observed) and its actions (k,
    size) for them."""
    fish, measure, settings = run.fish, run.measure, run.settings(0)
    motion, averages = settings.motion, settings.averages
    return Contract(
        version=1 + (motion is not None) + (averages is not None),
        fish=fish.name,
        fish_digest=digest(fish),
        band=fish.band,
        period=PERIOD,
        observation=table(measure, run.yaw_rate, motion is not None, averages is not None),
        actions=run.space(),
        training={**training, "versions": versions()},
        golden=(tuple(seen.tolist()), tuple(actions.tolist())),
        description=fish.model_dump(mode="json"),
        measure=measure,
        yaw_rate=run.yaw_rate,
        motion=motion,
        averages=averages,
    )


def save(model: onnx.ModelProto, path: Path) -> Policy:
    """Write a policy's file, overwriting one, and read it back. Raises BadInput."""
    with new_file(path, overwrite=True) as beside:
        onnx.save(model, str(beside))
    return load_policy(path)


def versions() -> dict[str, str]:
    """Versions of the packages that produced a policy."""
    return {name: version(name) for name in PRODUCED_BY} | {
        "python": platform.python_version(),
        "engine": mujoco.__version__,
    }


def act(model: SAC, seen: Single) -> Single:
    """Deterministic actions of the actor, before scaling, equal to those of the exported
    network."""
    with torch.no_grad():
        there = torch.as_tensor(seen, device=model.device)
        found: Single = model.actor(there, deterministic=True).cpu().numpy()
    return found


def as_onnx(model: SAC, contract: Contract) -> onnx.ModelProto:
    """The actor as ONNX: its layers with ReLU between them and tanh at the end; before them the
    target features, if the networks have them."""
    actor = model.actor
    layers: list[Any] = [m for m in actor.latent_pi if isinstance(m, torch.nn.Linear)] + [actor.mu]
    nodes, weights, name = _close_up(actor.features_extractor)
    for index, layer in enumerate(layers):
        for kind, tensor in (("w", layer.weight), ("b", layer.bias)):
            weights.append(numpy_helper.from_array(tensor.detach().cpu().numpy(), f"{kind}{index}"))
        nodes.append(
            helper.make_node("Gemm", [name, f"w{index}", f"b{index}"], [f"z{index}"], transB=1)
        )
        last = index == len(layers) - 1
        name = "action" if last else f"h{index}"
        nodes.append(helper.make_node("Tanh" if last else "Relu", [f"z{index}"], [name]))
    return model_of(nodes, weights, len(layers[-1].bias), contract)


def _close_up(extractor: Any) -> tuple[list[Any], list[Any], str]:
    """Nodes, weights and the name of the first layer's input."""
    if not isinstance(extractor, TargetFeatures):
        return [], [], "observation"
    held = extractor.named_buffers()
    weights = [numpy_helper.from_array(matrix.cpu().numpy(), name) for name, matrix in held]
    nodes = [
        linear("observation", "above", "numerator", "constant"),
        linear("observation", "below", "denominator", "range"),
        helper.make_node("Div", ["numerator", "denominator"], ["close"]),
    ]
    shown = ["observation", "close"]
    if extractor.has_course:
        nodes += [
            linear("observation", "speeds", "velocity"),
            helper.make_node("Mul", ["velocity", "velocity"], ["squares"]),
            linear("squares", "both", "square"),
            helper.make_node("Sqrt", ["square"], ["size"]),
            helper.make_node("Add", ["size", "slow"], ["speed"]),
            linear("close", "place", "places"),
            linear("observation", "way", "ways"),
            helper.make_node("Mul", ["places", "ways"], ["products"]),
            linear("products", "turn", "turned"),
            helper.make_node("Div", ["turned", "speed"], ["course"]),
        ]
        shown.append("course")
    nodes.append(helper.make_node("Concat", shown, ["features"], axis=1))
    return nodes, weights, "features"


def linear(given: str, matrix: str, name: str, *constant: str) -> onnx.NodeProto:
    """The node `name` = `given` times the transposed `matrix`, plus a `constant` if given."""
    return helper.make_node("Gemm", [given, matrix, *constant], [name], transB=1)


def model_of(
    nodes: list[Any], weights: list[Any], outputs: int, contract: Contract
) -> onnx.ModelProto:
    """A network from `observation` to so many outputs, `action`, with its contract."""
    inputs = len(contract.observation)
    seen = helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", inputs])
    action = helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", outputs])
    graph = helper.make_graph(nodes, "policy", [seen], [action], weights)
    made = helper.make_model(
        graph,
        producer_name="tailbeat",
        ir_version=IR,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    helper.set_model_props(made, {KEY: as_text(contract)})
    onnx.checker.check_model(made)
    return made
