"""The tasks of an evaluation by name."""

TRIALS = ("reach", "disturb", "track", "beyond")
NAMES = (*TRIALS, "spectrum", "twin")
