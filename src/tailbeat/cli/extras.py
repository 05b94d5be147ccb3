"""Refuse a verb whose packages are not installed, before it imports them."""

from tailbeat.files import need


def need_robot() -> None:
    """Raises BadInput if a package for the robot is missing."""
    need("the robot", "serial", "mcap")


def need_camera() -> None:
    """Raises BadInput if a package for the camera is missing."""
    need("the camera", "cv2", "pyapriltags")


def need_training() -> None:
    """Raises BadInput if a package for training is missing."""
    need("training", "stable_baselines3", "onnx", "tensorboard")
