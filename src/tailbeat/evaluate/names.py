"""The tasks of an evaluation by name."""

from collections.abc import Sequence

from tailbeat.files import BadInput

TRIALS = ("reach", "disturb", "track", "out-of-distribution", "messy")
NAMES = (*TRIALS, "spectrum", "twin")


def check_tasks(names: Sequence[str]) -> None:
    """Check the names of tasks. Raises BadInput; for an old name it gives the new one."""
    for name in names:
        if name not in NAMES:
            renamed = "; beyond is now called out-of-distribution" if name == "beyond" else ""
            raise BadInput(f"--tasks {name}: allowed are {', '.join(NAMES)}{renamed}.")
