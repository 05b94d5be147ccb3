"""Does a policy fit a fish? Compares the twin that it was trained in, and the body of the fish."""

from tailbeat.control.actions import PERIOD, Turning
from tailbeat.control.policy import Contract, Policy, check_fits, load_policy
from tailbeat.files import BadInput, leaves
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, fish_of, load_fish, shipped

# Fields of a description that an identification may change; all others describe the body. The servo
# as bought is none: the driver itself compares the model that answers.
NONE = "none"  # instead of an IMU's port
LAW = ("zones", "added_inertia", "added_along", "trailing_edge")  # of the fluid
FITTED = ("name", "summary", "servo", "simulation", "uncertain", "hardware", *LAW)
FITTED_IN_TAIL = ("tail.damping_time", "tail.friction", "tail.k_eff", "tail.stiffness_scale")


def twin_of(policy: Policy, twin: str | None) -> Fish:
    """The fish that a policy was trained on, with the servo that it had.

    `twin` is that fish's file, or None for the fish inside the policy; an older policy has none,
    so it must be of a shipped fish. Raises BadInput if it does not match the policy's contract.
    """
    contract = policy.contract
    described = carried(contract) if twin is None else load_fish(twin)
    variants = [described.model_copy(update={"servo": name}) for name in described.servos]
    same = [one for one in variants if digest(one) == contract.fish_digest]
    chosen = same[0] if same else described
    check_fits(contract, chosen.name, digest(chosen), chosen.band, PERIOD)
    return chosen


def carried(contract: Contract) -> Fish:
    """The fish inside a policy; for an older policy, the shipped fish of its name. Raises BadInput
    if there is neither."""
    if contract.description is not None:
        inside = fish_of(contract.description)
        check_fits(contract, inside.name, digest(inside), inside.band, PERIOD)
        return inside
    if contract.fish not in shipped():
        raise BadInput(
            f"policy: it was trained on {contract.fish}, which is not shipped, and does not carry"
            f" its fish; give the fish's file with --twin."
        )
    return load_fish(contract.fish)


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
    """The fish that a policy was trained on. Raises BadInput if the policy does not fit `fish`."""
    trained = twin_of(policy, twin)
    check_same_body(trained, fish)
    check_fits(policy.contract, trained.name, digest(trained), fish.band, PERIOD)
    return trained


def check_named(policy: str, fish: str) -> None:
    """Raises BadInput if a policy, by file or name, was trained for another fish than this one."""
    check_swims(load_policy(policy), None, load_fish(fish))


def check_same_body(twin: Fish, fish: Fish) -> None:
    """Check that twin and fish are the same body: equal in all fields that identification cannot
    change. Raises BadInput naming the fields that differ."""
    a, b = (leaves("", one.model_dump()) for one in (twin, fish))
    wrong = [
        f"{name} is {a.get(name)} in {twin.name}, {b.get(name)} in {fish.name}"
        for name in sorted(set(a) | set(b))
        if a.get(name) != b.get(name) and not _fitted(name)
    ]
    if wrong:
        more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise BadInput(
            f"the policy's fish is not the pool's: {'; '.join(wrong[:3])}{more}. Give the fish from"
            f" which the policy's fish was identified."
        )


def _fitted(name: str) -> bool:
    top = name.split(".")[0].removesuffix("s")
    stiffness = name.startswith("tail.links.") and name.endswith(".stiffness")
    tops = {one.removesuffix("s") for one in FITTED}
    return top in tops or name in FITTED_IN_TAIL or stiffness
