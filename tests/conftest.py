"""Shared fixtures: where the real recordings are."""

import os
from pathlib import Path

import pytest

import tailbeat  # noqa: F401  first: it chooses the engine's GL library

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of published measurements; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("TAILBEAT_DATA", ROOT / "../shared/data")).resolve()
    if not (folder / "fishsim").is_dir():
        pytest.skip(f"no recordings in {folder}; set TAILBEAT_DATA to the folder of fishsim/")
    return folder


@pytest.fixture(scope="session", autouse=True)
def no_engine_warning():
    """MuJoCo reports a diverged run in a log file in the working folder; no test may cause one."""
    log = Path("MUJOCO_LOG.TXT")
    before = log.read_text() if log.exists() else ""
    yield
    after = log.read_text() if log.exists() else ""
    assert after == before, f"the engine warned: {after[len(before) :]}"
