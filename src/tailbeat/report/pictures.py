"""Names of pictures that a figure may be written to."""

from pathlib import Path

from tailbeat.files import BadInput

PICTURES = (".png", ".svg", ".pdf")


def check_picture(path: Path) -> None:
    """Raises BadInput for a figure's name with another suffix than `PICTURES`."""
    if path.suffix.lower() not in PICTURES:
        raise BadInput(f"{path}: a figure is written as {', '.join(PICTURES)}; rename it.")
