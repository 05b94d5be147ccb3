"""What the station says of a camera that moved. Imports nothing: a station may have no camera."""

MOVED = 0.015  # m of a fixed tag from its place: waves and noise move it by less (chosen)


def warning(moved: float) -> str:
    """What the station says of it, "" for nothing."""
    if not moved > MOVED:
        return ""
    return f"a fixed tag is {100 * moved:.1f} cm off: the camera moved; calibrate it again"
