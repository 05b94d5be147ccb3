"""A policy is one ONNX file: a network, and the contract that says what its numbers mean.

The contract holds all that is between sensors and a motor angle: observation table, action space
with every scale, period, fish, band, versions, how the policy was trained, and golden pairs of
observation and action. A file that does not match its contract is refused, and the error names
the field. Needs only numpy and onnxruntime.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from tailbeat.control import policy_checks as checks
from tailbeat.control.actions import (
    ActionSpace,
    Direct,
    Filtered,
    Generator,
    Turning,
    check_space,
)
from tailbeat.control.averages import Averages
from tailbeat.control.camera_yaw import Source
from tailbeat.control.corrections import Corrections
from tailbeat.control.corrections import from_contract as corrections_from
from tailbeat.control.expected import KEY as EXPECTED
from tailbeat.control.expected import Expected
from tailbeat.control.expected import read as read_expected
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.motion import MotionFilter
from tailbeat.control.network_file import check_network
from tailbeat.control.observation import Entry, table
from tailbeat.files import BadInput

Single = NDArray[np.float32]
# 2: the policy sees velocities, and the contract has their filter; 3: it sees averages too
VERSIONS = (1, 2, 3)
LATER = {
    "description",
    "measure",
    "yaw_rate",
    "motion",
    "averages",
    "corrections",
}  # fields that older files lack
KEY = "tailbeat"  # of the file's metadata
SPACES = {"generator": Generator, "direct": Direct, "filtered": Filtered, "turning": Turning}


@dataclass(frozen=True)
class Contract:
    """What a policy was trained to see, do and swim in."""

    version: int
    """Version of the contract's format."""
    fish: str
    """Name of the fish."""
    fish_digest: str
    """Digest of the fish's description, so that a change of any number is seen."""
    band: tuple[float, float]
    """Identified beat frequencies, lowest and highest [Hz]."""
    period: float
    """Period of control [s]."""
    observation: tuple[Entry, ...]
    """Inputs of the network in their order, with units and scales; 24, in version 2 28, in 3
    42."""
    actions: ActionSpace
    """Action space with every scale, ceiling and time constant."""
    training: dict[str, Any]
    """How the policy was trained: recipe, seed, stage, versions and what the task was."""
    golden: tuple[tuple[list[float], ...], tuple[list[float], ...]]
    """Observations (k, 24) and the actions (k, size) that the network must give for them."""
    description: dict[str, Any] | None = None
    """The whole fish in SI, as it was trained on; None in policies of releases up to 0.2.0."""
    measure: Measure = field(default_factory=Measure)
    """The fish's measure, over the paper's fish, whose ratios are 1. It sizes arrivals, targets and
    the scales of the observation. Without it in the file they are 1."""
    yaw_rate: Source = "imu"
    """Source of the yaw rate, "imu" or "camera". Without it in the file it is the IMU."""
    motion: MotionFilter | None = None
    """Constants of the filter of velocities, from version 2 on; None in version 1."""
    averages: Averages | None = None
    """Time constants of the averages, from version 3 on; None before."""
    corrections: Corrections | None = None
    """Errors of the one robot that it swims on, by `tailbeat refine`; None for any robot."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A loaded policy: see `decide`. `expected` says what its swims look like to the robot, if its
    file does."""

    contract: Contract
    session: onnxruntime.InferenceSession
    expected: Expected | None = None


def decide(policy: Policy, observation: Single) -> Single:
    """Deterministic actions (n, size), within [-1, 1], for observations (n, 24, 28 or 42). Values
    are not checked: an observation that is not finite gives an action that is not."""
    answer: Single = policy.session.run(None, {"observation": observation})[0]
    return answer


# ---- the contract in the file -------------------------------------------------------------------


def as_text(contract: Contract) -> str:
    """The contract as the file carries it: JSON, and a digest of every field."""
    content = asdict(contract)
    if contract.description is None:
        del content["description"], content["measure"]  # an older file stays as it was
    for name in ("motion", "averages", "corrections"):
        if content[name] is None:
            del content[name]
    if contract.yaw_rate == "imu":
        del content["yaw_rate"]  # so does a file of before this field
    return json.dumps({"contract": content, "digests": _digests(content)}, sort_keys=True)


def contract_digest(contract: Contract) -> str:
    """Digest of a contract, by which runs and refined policies know a policy again."""
    return hashlib.sha256(as_text(contract).encode()).hexdigest()[:16]


def _digests(content: dict[str, Any]) -> dict[str, str]:
    def digest(value: Any) -> str:
        return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]

    return {name: digest(value) for name, value in content.items()}


def shipped() -> dict[str, Path]:
    """Paths of the policies that come with the package, by name."""
    folder = Path(str(resources.files("tailbeat.control") / "policies"))
    return {path.stem: path for path in sorted(folder.glob("*.onnx"))}


def policy_path(name_or_path: str | Path) -> Path:
    """Path of a shipped policy by its name, else of a file. Raises BadInput if there is neither."""
    path = shipped().get(str(name_or_path), Path(name_or_path))
    if path.is_file():
        return path
    raise BadInput(
        f"{path}: no such file; give a policy, an .onnx file or one of {', '.join(shipped())}."
        f"{_others(path)}"
    )


def _others(path: Path) -> str:
    """Where a policy may be that is given by a name; earlier defaults have their seed there."""
    if path.name != str(path) or path.suffix == ".onnx":
        return ""
    return (
        f" Others, earlier defaults too, are in the source's examples/policies*/: give the path of"
        f" {path}.onnx or {path}-0.onnx there."
    )


def load_policy(name_or_path: str | Path) -> Policy:
    """Read a policy, by a shipped name or from a file, and check it against its contract: every
    field's digest, the observation table, and the golden pairs. Raises BadInput that names what is
    wrong."""
    path = policy_path(name_or_path)
    network, options = check_network(path), onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are reported below
    # An optimised network runs its constant layers while it is loaded, where no time ends. A
    # decision takes 19.6 us instead of 18.7, and is the same to the last bit.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen kinds of its own
        raise BadInput(f"{path}: not a readable ONNX file; export the policy again.") from error
    metadata = session.get_modelmeta().custom_metadata_map
    text = metadata.get(KEY)
    if text is None:
        raise BadInput(
            f"{path}: an ONNX file without a contract; give a policy that tailbeat exported."
        )
    expected = read_expected(path, metadata.get(EXPECTED))
    policy = Policy(_contract(path, text), session, expected)
    held = policy.contract
    checks.check_golden(path, session, held.golden, len(held.observation), held.actions)
    return policy


def _contract(path: Path, text: str) -> Contract:
    try:
        held = json.loads(text)
        content, digests = held["contract"], held["digests"]
        version = content["version"]
        if not isinstance(digests, dict):
            raise TypeError("digests are not a table")
        checks.check_depth(content)
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise BadInput(f"{path}: its contract cannot be read; export the policy again.") from error
    if version not in VERSIONS:
        raise BadInput(
            f"{path}: contract version {version}; this tailbeat reads {VERSIONS[0]} to"
            f" {VERSIONS[-1]}. Use the tailbeat that exported it."
        )
    names = [field.name for field in fields(Contract)]
    odd = sorted((set(content) | LATER) ^ set(names))
    if odd:
        raise BadInput(f"{path}: contract has missing or unknown fields {odd}; export it again.")
    changed = [name for name, value in _digests(content).items() if digests.get(name) != value]
    if changed:
        raise BadInput(
            f"{path}: {', '.join(changed)} changed after the policy was exported; export it again."
        )
    content["measure"] = checks.measure_from(path, content.get("measure", {}))
    try:
        contract = _built(content)
        check_space(contract.actions)
    except BadInput as error:
        raise BadInput(f"{path}: {error} Export the policy again.") from None
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise BadInput(
            f"{path}: a field of its contract is not what it should be ({error!r}); export it"
            f" again."
        ) from None
    checks.check_times(path, contract.band, contract.period)
    checks.check_source(path, contract.yaw_rate)
    ours = observed_by(contract)
    checks.check_observation(path, contract.observation, ours)
    checks.check_pairs(path, contract.golden, contract.observation, contract.actions)
    return contract


def _built(content: dict[str, Any]) -> Contract:
    checks.check_kinds(content)
    content["observation"] = tuple(Entry(**entry) for entry in content["observation"])
    content["actions"] = SPACES[content["actions"]["kind"]](**content["actions"])
    low, high = map(float, content["band"])
    content["band"] = (low, high)
    content["golden"] = tuple(tuple(side) for side in content["golden"])
    for name, kind, since in (("motion", MotionFilter, 2), ("averages", Averages, 3)):
        held = content.get(name)
        content[name] = checks.constants_from(kind, held, content["version"] >= since)
    content["corrections"] = corrections_from(content.get("corrections"))
    return Contract(**content)


def observed_by(contract: Contract) -> tuple[Entry, ...]:
    """The observation table that this package makes for a policy."""
    kinds = contract.motion is not None, contract.averages is not None
    return table(contract.measure, contract.yaw_rate, *kinds)


def measure_in(name_or_path: str | None) -> Measure:
    """The measure in a policy's contract; the paper's fish's for None. Raises BadInput."""
    return PAPER if name_or_path is None else load_policy(name_or_path).contract.measure


# ---- which fish it may run on -------------------------------------------------------------------


def check_fits(
    contract: Contract, fish: str, digest: str, band: tuple[float, float], period: float
) -> None:
    """Raises BadInput if a policy was trained for another fish, another description of it
    (`digest`), another band [Hz] or another control period [s]. It names each difference."""
    refuse(unfit(contract, fish, digest, band, period))


def unfit(
    contract: Contract, fish: str, digest: str, band: tuple[float, float], period: float
) -> list[str]:
    """The differences for which `check_fits` refuses a policy."""
    wrong = []
    if contract.fish != fish:
        wrong.append(f"fish is {contract.fish}, here {fish}")
    elif contract.fish_digest != digest:
        wrong.append(f"{fish}'s description has changed since the training")
    if tuple(contract.band) != tuple(band):
        wrong.append(f"band is {_range(contract.band)} Hz, here {_range(band)} Hz")
    if contract.period != period:
        wrong.append(f"period is {1e3 * contract.period:g} ms, here {1e3 * period:g} ms")
    return wrong


def refuse(wrong: list[str]) -> None:
    """Raises BadInput if there are differences between a policy and its fish."""
    if wrong:
        raise BadInput(
            f"policy: {'; '.join(wrong)}. Train one for this fish, or pass the fish it was trained"
            f" on."
        )


def _range(band: tuple[float, float]) -> str:
    return f"{band[0]:g}-{band[1]:g}"
