"""Refuse a verb whose packages are not installed, before it imports them."""

from tailbeat.files import need


def need_robot() -> None:
    """Raises BadInput where the robot's packages are missing."""
    need("the robot", "serial", "mcap")


def need_camera() -> None:
    """Raises BadInput where the camera's packages are missing."""
    need("the camera", "cv2", "pyapriltags")


def need_training() -> None:
    """Raises BadInput where the packages of training are missing."""
    need("training", "stable_baselines3", "onnx", "tensorboard")
