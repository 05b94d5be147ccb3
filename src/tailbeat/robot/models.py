"""Servo models: which the drivers refuse, and what the current of one says of its torque."""

import math

from tailbeat.control.load import Motor
from tailbeat.files import BadInput
from tailbeat.fish.catalogue import by_number
from tailbeat.fish.description import Fish, Hardware
from tailbeat.robot.dynamixel_tables import P_NUMBERS, P_STEPS

# ROBOTIS servos that speak Protocol 2.0 and have other addresses, by model number (DynamixelSDK).
ELSEWHERE = (
    (range(350, 351), "XL-320"),
    (range(4000, 5000), "Y series"),
)


def check_model(path: str, number: int, hardware: Hardware) -> None:
    """Raises BadInput if the servo that answers is not the fish's, or no driver has its
    addresses."""
    series = next((name for numbers, name in ELSEWHERE if number in numbers), "")
    if series and hardware.family.startswith("dynamixel"):
        raise BadInput(
            f"{path}: model number {number} answers ({series}); its control table has other"
            f" addresses than the X and P series, and tailbeat does not support it."
        )
    told = "dynamixel-p" if number in P_NUMBERS else "dynamixel-x"
    if hardware.family.startswith("dynamixel") and hardware.family != told:
        raise BadInput(
            f"{path}: model number {number} answers, and the fish's family is {hardware.family};"
            f' write family = "{told}" into its [hardware] table.'
        )
    if number in P_NUMBERS and number not in P_STEPS:
        raise BadInput(
            f"{path}: model number {number} answers, and tailbeat does not know how many counts it"
            f" has for a turn; P models that it drives: {', '.join(map(str, P_STEPS))}."
        )
    if number != hardware.number:
        raise BadInput(
            f"{path}: model number {number} answers, the fish's {hardware.model} has"
            f" {hardware.number}; give its port, or the right servo in the fish's [hardware] table."
        )


def no_answer(path: str, ident: int, baud: int, fault: Exception) -> BadInput:
    """What to raise where no servo with this id answers."""
    return BadInput(
        f"{path}: no servo {ident} answers at {baud} baud ({fault}); check cable, power,"
        f" id and baud rate, or find it with `tailbeat prepare --servo {path} --fish FISH`."
    )


def motor_of(twin: Fish, hardware: Hardware) -> Motor | None:
    """What the current of a servo says of its torque, with the inertia and the back EMF that its
    twin has; None for a model that the catalogue lacks, and for one that reports a load: that is
    its duty, not its torque. Stall torque over stall current was not checked on a servo."""
    known = by_number(hardware.number)
    if known is None or not known.current_ma or math.isnan(known.torque_per_ampere):
        return None
    servo = twin.servos[twin.servo]
    return Motor(known.torque_per_ampere, servo.armature, servo.damping)
