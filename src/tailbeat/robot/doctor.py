"""All checks before a swim, in the order in which things usually fail.

Every check is a function that returns findings and moves nothing. The camera's checks are functions
of the same kind; the caller passes them in when there is a camera.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.control.policy import load_policy
from tailbeat.files import BadInput
from tailbeat.fish.description import Hardware
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.link import datagrams as link
from tailbeat.robot import doctor_computer as computer
from tailbeat.robot import doctor_devices as devices
from tailbeat.robot import doctor_link
from tailbeat.robot.findings import BAD, Finding, finding
from tailbeat.robot.fits import NONE, check_swims, check_yaw_rate
from tailbeat.robot.ports import Ports

Check = Callable[[], list[Finding]]


@dataclass(frozen=True)
class Parts:
    """Where the parts are. A part that is "" or None is not checked."""

    servo: str = ""
    imu: str = ""
    listen: tuple[str, int] | None = None
    station: tuple[str, int] | None = None
    key: Path | None = None

    @classmethod
    def of(cls, ports: Ports, key: Path) -> "Parts":
        """The parts at a fish's ports."""
        return cls(ports.servo, ports.imu, ports.listen, ports.station, key)


def examine(
    policy: str, fish: str, parts: Parts, logs: Path, cameras: Sequence[Check] = ()
) -> list[Finding]:
    """Run every check that applies; `cameras` are the camera's checks. Raises BadInput for a fish
    that cannot be read."""
    hardware = hardware_of(load_fish(fish))
    return [
        *check_policy(policy, fish),
        *of_computer(logs),
        *of_servo(parts, hardware),
        *of_imu(parts, hardware),
        *check_yaw_source(policy, parts.imu),
        *of_link(parts),
        *(finding for check in cameras for finding in check()),
    ]


def of_camera(camera: str, calibration: Path | None, fish: str) -> list[Check]:
    """The checks of a camera above a fish; none if `camera` is "". Raises BadInput if it has no
    calibration."""
    if not camera:
        return []
    if calibration is None:
        raise BadInput(
            "--camera needs --calibration: give the file that `tailbeat calibrate` wrote."
        )
    from tailbeat.robot.doctor_camera import check_camera  # needs OpenCV
    from tailbeat.vision.tags import FISH, TARGET

    tag = load_fish(fish).tag
    return [lambda: check_camera(camera, calibration, (FISH, TARGET), tag)]


def check_policy(policy: str, fish: str) -> list[Finding]:
    """Whether the policy can be loaded, and fits this fish."""
    try:
        loaded = load_policy(policy)
    except BadInput as error:
        do = "export it again, or name a shipped one"
        return [finding("policy", str(error), bad=True, do=do)]
    contract = loaded.contract
    found = [finding("policy", f"trained for {contract.fish}")]
    try:
        check_swims(loaded, None, load_fish(fish))
    except BadInput as error:
        do = "train a policy for this fish, or give the fish that this one was trained for"
        return [*found, finding("policy fits the fish", str(error), bad=True, do=do)]
    return [*found, finding("policy fits the fish", fish)]


def of_computer(logs: Path) -> list[Finding]:
    """Check disk, rights, processor clock, wireless."""
    return [
        computer.check_disk(logs),
        *computer.check_scheduling(),
        computer.check_governor(),
        computer.check_wireless(),
    ]


def of_servo(parts: Parts, hardware: Hardware) -> list[Finding]:
    """Check the servo: its port, its answer, its registers."""
    find = partial(devices.find_servo, hardware=hardware)
    check = partial(devices.check_servo, hardware=hardware)
    return _of_device("servo's port", parts.servo, find, check)


def of_imu(parts: Parts, hardware: Hardware) -> list[Finding]:
    """Check the IMU: its port, its answer, its mounting, its noise."""
    if parts.imu == NONE:
        return [finding("IMU answers", "none: the camera gives the yaw rate")]
    find = partial(devices.find_imu, hardware=hardware)
    check = partial(devices.check_imu, hardware=hardware)
    return _of_device("IMU's port", parts.imu, find, check)


def check_yaw_source(policy: str, imu: str) -> list[Finding]:
    """Whether the policy was trained with the yaw rate that this robot has."""
    if not imu:
        return []
    try:
        contract = load_policy(policy).contract
    except BadInput:
        return []  # `check_policy` says it
    try:
        check_yaw_rate(contract, imu)
    except BadInput as error:
        do = "take a policy that fits the robot; --force-camera-yaw-rate tries this one"
        return [finding("policy's yaw rate", str(error), bad=True, do=do)]
    source = "an IMU" if contract.yaw_rate == "imu" else "the camera"
    return [finding("policy's yaw rate", f"from {source}")]


def _of_device(
    name: str, path: str, find: Callable[..., Any], check: Callable[..., Any]
) -> list[Finding]:
    """Check the port, whether the device answers there, and what it reports about itself."""
    if not path:
        return []
    found = devices.check_port(name, path)
    if any(finding.verdict == BAD for finding in found[:1]):
        return found
    device, answer = find(path)
    if device is None:
        return [*found, answer]
    with device.port:  # reads only
        return [*found, answer, *check(device)]


def of_link(parts: Parts) -> list[Finding]:
    """Check key, own address, station."""
    if parts.listen is None and parts.key is None:
        return []
    key = doctor_link.check_key(parts.key)
    if key.verdict == BAD or parts.key is None or parts.listen is None or parts.station is None:
        return [key]
    try:
        made = link.bind(*parts.listen)
    except BadInput as error:
        return [key, finding("own address", str(error), bad=True, do="give another address")]
    with made:
        receiver = link.Receiver(link.read_key(parts.key))
        return [key, *doctor_link.check_link(made, parts.station, receiver)]
