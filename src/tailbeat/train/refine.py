"""The day after: correct a policy by what its robot's logs show to be constant and wrong.

Offsets are calibrations, so the network stays as it is: the contract frees readings and setpoints
of them. The corrected policy is a new file that names its parent.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import pi
from pathlib import Path

from tailbeat.control.corrections import LARGEST, Corrections, check
from tailbeat.control.policy import (
    KEY,
    Contract,
    Policy,
    as_text,
    contract_digest,
    load_policy,
    policy_path,
)
from tailbeat.files import BadInput, refuse_existing, write_json
from tailbeat.identify.offsets import Offset, Offsets
from tailbeat.robot.logged import check_swum_by, offsets_of
from tailbeat.train.metadata import put


@dataclass(frozen=True)
class Correctable:
    """An offset that a contract can correct: its name in `offsets`, the contract's, its SI factor,
    and how far labs are off (rms, in its unit, chosen: twice the everyday size)."""

    offset: str
    name: str
    si: float
    usual: float


CORRECTABLE = (
    Correctable("tag askew", "askew", pi / 180, 10.0),
    Correctable("tag sideways", "left", 1e-3, 20.0),
    Correctable("shaft at straight", "shaft", pi / 180, 10.0),
    Correctable("command at straight", "setpoint", pi / 180, 10.0),
    Correctable("gyro bias", "yaw_rate", 1.0, 0.2),
)


@dataclass(frozen=True)
class Change:
    """A number of the contract before and after, in `unit`, what the swims `found` with its 95 %
    interval, and why it is what it is."""

    name: str
    unit: str
    before: float
    after: float
    found: float
    interval: tuple[float, float]
    why: str


@dataclass(frozen=True)
class Refined:
    """A corrected policy, its parent's digest, what changed, over `seconds` of swimming in `runs`
    swims, and what no swim alone tells."""

    policy: str
    parent: str
    changes: tuple[Change, ...]
    seconds: float
    runs: int
    untold: tuple[str, ...]
    damage: tuple[str, ...] = ()
    """What the logs lack, a sentence each."""


def refine(policy: str, logs: Sequence[Path], out: Path) -> Refined:
    """Correct a policy from logs of its swims; writes `policy.onnx` and `refined.json` into `out`.
    Raises BadInput for logs of another policy, too short ones, or offsets beyond what labs get
    wrong; nothing is written then."""
    path, held = policy_path(policy), load_policy(policy)
    new = out / "policy.onnx"
    refuse_existing(new)
    refuse_existing(out / "refined.json")
    check_swum_by(logs, path)
    found = offsets_of(logs)
    corrections, changes = corrected(held.contract, found)
    write(path, replace(held.contract, corrections=corrections), new)
    told = found.seconds, found.runs, found.untold, found.damage
    done = Refined(str(new), corrections.parent, changes, *told)
    write_json(out / "refined.json", done)
    return done


def corrected(contract: Contract, found: Offsets) -> tuple[Corrections, tuple[Change, ...]]:
    """New corrections of a contract, and what changed. Raises BadInput for one that is larger than
    a lab can have it.

    A log has the readings as they came, so what it shows is a whole offset, not a change of one.
    """
    held = asdict(contract.corrections or Corrections())
    rows, blind = {row.name: row for row in found.offsets}, contract.yaw_rate == "camera"
    changes = [
        _change(rows[one.offset], one, held[one.name], blind and one.name == "yaw_rate")
        for one in CORRECTABLE
    ]
    for one in CORRECTABLE:
        _refuse_large(rows[one.offset], one)
    values = {one.name: made.after * one.si for one, made in zip(CORRECTABLE, changes, strict=True)}
    made = Corrections(**values, parent=contract_digest(contract))
    try:
        check(made)
    except ValueError as error:
        raise BadInput(f"logs: {error}; that is more than glue or a horn errs: mend it.") from None
    return made, tuple(changes)


def _refuse_large(row: Offset, one: Correctable) -> None:
    """Raises BadInput if the swims are sure of more than a lab can have wrong."""
    most, nearest = LARGEST[one.name] / one.si, min(abs(edge) for edge in row.interval)
    if row.interval[0] * row.interval[1] > 0 and nearest > most:
        raise BadInput(
            f"logs: {row.name} is {row.value:.3g} {row.unit}; allowed is {-most:.3g} to {most:.3g}:"
            f" that is more than glue or a horn errs. Mend it on the robot, and swim again."
        )


def _change(row: Offset, one: Correctable, before: float, blind: bool) -> Change:
    """What an offset changes: the mean of what the swims say and of what was corrected `before`,
    which is off by what is usual, each by its own doubt. So a wide interval changes little."""
    kept = before / one.si
    own = row.name, row.unit, kept
    if blind:
        return Change(*own, kept, row.value, row.interval, "kept: the policy sees no gyro")
    doubt = (row.interval[1] - row.interval[0]) / 4  # a deviation, of a 95 % interval
    share = one.usual**2 / (one.usual**2 + doubt**2)
    doubtful = f"{100 * share:.0f} % of the way there: the swims are in doubt"
    why = "told by the swims" if row.told else doubtful
    return Change(*own, kept + share * (row.value - kept), row.value, row.interval, why)


def write(old: Path, contract: Contract, new: Path) -> Policy:
    """Write a policy's network under another contract into a new file, and read it back."""
    return put(old, KEY, as_text(contract), new)
