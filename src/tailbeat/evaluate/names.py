"""The tasks of an evaluation by name."""

from collections.abc import Sequence

from tailbeat.files import BadInput

TRIALS = ("reach", "disturb", "track", "out-of-distribution")
NAMES = (*TRIALS, "spectrum", "twin")


def check_tasks(names: Sequence[str]) -> None:
    """Raises BadInput where one is not a task; of the name of earlier versions it says the new."""
    for name in names:
        if name not in NAMES:
            renamed = "; beyond is now called out-of-distribution" if name == "beyond" else ""
            raise BadInput(f"--tasks {name}: allowed are {', '.join(NAMES)}{renamed}.")
