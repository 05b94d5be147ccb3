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


@pytest.hookimpl(tryfirst=True)  # before the plugin reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Say which tests share a process of `pytest -n`: those that measure time, one after another,
    and those that share a module's fixture, which is then made once."""
    if hasattr(config, "workerinput"):  # one of the processes of `pytest -n`
        for item in items:
            if (group := _group(item)) is not None:
                item.add_marker(pytest.mark.xdist_group(group))


def _group(item: pytest.Item) -> str | None:
    if item.get_closest_marker("realtime"):
        return "realtime"
    shared = (made[-1].scope == "module" for made in item._fixtureinfo.name2fixturedefs.values())  # type: ignore[attr-defined]
    return item.path.stem if any(shared) else None
