"""Does a policy fit a fish? Compares the twin that it was trained in, and the body of the fish."""

import math

from tailbeat.control.actions import PERIOD, ActionSpace, Turning, check_band
from tailbeat.control.policy import Contract, Policy, check_fits, load_policy, refuse, unfit
from tailbeat.files import BadInput, leaves
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, fish_of, load_fish, shipped

NONE = "none"  # instead of an IMU's port
SHOWN = 5  # fields of a body that are named with their values; of others, the table
# Fields of a description that an identification may change; all others describe the body. The servo
# as bought is none (the driver itself compares the model that answers), nor is the tag's size.
LAW = ("zones", "added_inertia", "added_along", "trailing_edge")  # of the fluid
FITTED = ("name", "summary", "servo", "simulation", "uncertain", "hardware", "lab", "tag", *LAW)
FITTED_IN_TAIL = ("tail.damping_time", "tail.friction", "tail.k_eff", "tail.stiffness_scale")


def twin_of(policy: Policy, twin: str | None) -> Fish:
    """The fish that a policy was trained on, with the servo that it had.

    `twin` is that fish's file, or None for the fish inside the policy; an older policy has none,
    so it must be of a shipped fish. Raises BadInput if it does not match the policy's contract.
    """
    if twin is None:
        return carried(policy.contract)
    return _matched(policy.contract, load_fish(twin))


def carried(contract: Contract) -> Fish:
    """The fish inside a policy; for an older policy, the shipped fish of its name. Raises BadInput
    if there is neither, or if it does not match the contract."""
    if contract.description is not None:
        return _matched(contract, fish_of(contract.description))
    if contract.fish not in shipped():
        raise BadInput(
            f"policy: it was trained on {contract.fish}, which is not shipped, and does not carry"
            f" its fish; give the fish's file with --twin."
        )
    return _matched(contract, load_fish(contract.fish))


def _matched(contract: Contract, described: Fish) -> Fish:
    """A fish with the servo that it had in the training. Raises BadInput if the contract is of
    another fish."""
    variants = [described.model_copy(update={"servo": name}) for name in described.servos]
    same = [one for one in variants if digest(one) == contract.fish_digest]
    chosen = same[0] if same else described
    check_fits(contract, chosen.name, digest(chosen), chosen.band, PERIOD)
    return chosen


def check_driven(contract: Contract) -> None:
    """Raises BadInput for a policy whose motor the driver cannot turn: it commands angles within
    one turn."""
    if isinstance(contract.actions, Turning):
        raise BadInput(
            f"policy: it turns {contract.fish}'s motor without end, and the robot's driver commands"
            f" angles within a turn; try it with `tailbeat evaluate`."
        )


def check_yaw_rate(contract: Contract, imu: str, forced: bool = False) -> None:
    """Raises BadInput if a policy was trained with another yaw rate than the robot has. `imu` is
    its port, or "none": then the camera gives the yaw rate. `forced` accepts the camera's for a
    policy that was trained with an IMU."""
    camera = imu == NONE
    if forced and not camera:
        raise BadInput("--force-camera-yaw-rate: it needs --imu none; omit it.")
    if camera and contract.yaw_rate == "imu" and not forced:
        raise BadInput(
            "policy: it was trained with an IMU, and with --imu none it gets the camera's yaw rate,"
            " which is later and noisier; train one with `tailbeat train --imu none`, or add"
            " --force-camera-yaw-rate."
        )
    if not camera and contract.yaw_rate == "camera":
        raise BadInput("policy: it was trained without an IMU; give --imu none.")


def check_swims(policy: Policy, twin: str | None, fish: Fish) -> Fish:
    """The fish that a policy was trained on. Raises BadInput that names all differences if the
    policy does not fit `fish`."""
    contract, trained = policy.contract, twin_of(policy, twin)
    body = [one for one in _unlike(trained, fish) if not one.startswith("band.")]
    wrong = unfit(contract, trained.name, digest(trained), fish.band, PERIOD)
    wrong += [*_unlike_motor(contract.actions, fish), *_unlike_servo(policy, trained)]
    _refuse_bodies(body, wrong)
    refuse(wrong)
    return trained


def check_named(policy: str, fish: str) -> None:
    """Raises BadInput if a policy, by file or name, was trained for another fish than this one."""
    check_swims(load_policy(policy), None, load_fish(fish))


def check_same_body(twin: Fish, fish: Fish) -> None:
    """Check that twin and fish are the same body: equal in all fields that identification cannot
    change. Raises BadInput naming the fields that differ."""
    _refuse_bodies(_unlike(twin, fish), [])


def _unlike(twin: Fish, fish: Fish) -> list[str]:
    """The fields in which two bodies differ, with their values; those of fewest dots first."""
    a, b = (leaves("", one.model_dump()) for one in (twin, fish))
    names = sorted(set(a) | set(b), key=lambda name: (name.count("."), name))
    return [
        f"{name} is {a.get(name)} in {twin.name}, {b.get(name)} in {fish.name}"
        for name in names
        if a.get(name) != b.get(name) and not _fitted(name)
    ]


def _unlike_motor(space: ActionSpace, fish: Fish) -> list[str]:
    """What a fish's motor or band does not allow of an action space."""
    if isinstance(space, Turning) != (fish.motor.range is None):
        return [f"actions are {space.kind}, here the motor is a {fish.motor.kind}"]
    found, (low, high) = [], fish.motor.range or (-math.inf, math.inf)
    if space.low < low or space.high > high:
        found.append(
            f"actions reach {space.low:g} to {space.high:g} rad, here the motor allows {low:g} to"
            f" {high:g} rad"
        )
    try:
        check_band(space, fish.band[1])
    except BadInput as beyond:
        found.append(str(beyond).split("; ")[0])
    return found


def _unlike_servo(policy: Policy, trained: Fish) -> list[str]:
    """Where the shaft that a policy's file expects has not the servo of the training."""
    if policy.expected is None:
        return []
    shaft, servo = policy.expected.shaft, trained.servos[trained.servo]
    return [
        f"expected {name} of the servo is {getattr(shaft, name):g}, here {getattr(servo, name):g}"
        for name in ("kp", "kv", "force_limit", "delay")
        if not math.isclose(getattr(shaft, name), getattr(servo, name), rel_tol=1e-9)
    ]


def _refuse_bodies(body: list[str], others: list[str]) -> None:
    """Raises BadInput if bodies differ; it also names the other differences of the policy."""
    if not body:
        return
    more = sorted({one.split(".")[0] for one in body[SHOWN:]})
    rest = [f"{len(body) - SHOWN} more fields of {', '.join(more)}"] if more else []
    raise BadInput(
        f"the policy's fish is not the pool's: {'; '.join([*body[:SHOWN], *rest, *others])}. Give"
        f" the fish from which the policy's fish was identified."
    )


def _fitted(name: str) -> bool:
    top = name.split(".")[0].removesuffix("s")
    stiffness = name.startswith("tail.links.") and name.endswith(".stiffness")
    tops = {one.removesuffix("s") for one in FITTED}
    return top in tops or name in FITTED_IN_TAIL or stiffness
