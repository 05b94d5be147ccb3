"""Provenance of results: which code, on which machine."""

import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tailbeat import __version__


@dataclass(frozen=True)
class Provenance:
    """Version and commit of the package, Python's version, the machine."""

    tailbeat: str
    commit: str
    python: str
    machine: str


def provenance() -> Provenance:
    """The provenance of this process."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short=12", "HEAD"]
    try:
        commit = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "not a checkout"
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return Provenance(__version__, commit, platform.python_version(), machine)
