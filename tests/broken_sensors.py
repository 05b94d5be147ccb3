"""Five kinds of glitches for tests: what sensors, buses and cameras do to a good recording."""

from dataclasses import replace

import numpy as np

from tailbeat.recording import Recording

KINDS = ("spike", "burst", "frozen", "swapped", "stuck")
COUNT = 2 * np.pi / 4096


def glitched(
    recording: Recording, columns: list[str], seed: int, share: float = 0.02
) -> tuple[Recording, dict[str, np.ndarray]]:
    """The recording with a share of each column's samples replaced, a fifth by each kind, and
    which they are."""
    rng = np.random.default_rng(seed)
    made, where = dict(recording.columns), {}
    for name in columns:
        made[name], where[name] = _broken(made[name], share, rng)
    return replace(recording, columns=made), where


def _broken(true: np.ndarray, share: float, rng) -> tuple[np.ndarray, np.ndarray]:
    values, bad = true.copy(), np.zeros(true.size, dtype=bool)
    each = max(round(share * true.size / len(KINDS)), 1)
    for kind in KINDS:
        left = each
        while left > 0:
            length = min(left, {"spike": 1, "swapped": 1}.get(kind, int(rng.integers(3, 9))))
            at = int(rng.integers(2, true.size - length - 2))
            if bad[at - 2 : at + length + 2].any():
                continue
            part = slice(at, at + length)
            values[part] = _wrong(kind, true, part, rng)
            bad[part] = True
            left -= length
    return values, bad


def _wrong(kind: str, true: np.ndarray, part: slice, rng) -> np.ndarray:
    if kind == "spike":
        return np.full(1, -3.14)
    if kind == "burst":
        return true[part] + rng.choice([-1, 1]) * rng.uniform(0.3, 3.0, part.stop - part.start)
    if kind == "frozen":
        return np.full(part.stop - part.start, true[part.start - 1])
    if kind == "stuck":
        return np.full(part.stop - part.start, rng.choice([0.0, np.pi, 1.5]))
    count = np.round(true[part] / COUNT).astype(int) + 2048
    return (((count & 0xFF) << 8 | count >> 8) - 2048) * COUNT
