"""Shared fixtures: where the real recordings are; which tests run beside which."""

import gc
import os
import re
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

import tailbeat  # noqa: F401  first: it chooses the engine's GL library
from tailbeat.processes import ALONE

if "PYTEST_XDIST_WORKER" in os.environ:  # its threads would wait for those of other processes
    os.environ.update(ALONE)

NICE = 5  # weight 335 for 1024
ROOT = Path(__file__).parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--again",
        action="store_true",
        help="with --last-failed: a second try for tests that measure time, and for no other",
    )


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


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser for the operator page."""
    from browser import open_browser  # needs selenium

    with open_browser() as made:
        yield made


def pytest_configure(config: pytest.Config) -> None:
    """No search for garbage among what is imported and collected, which stays: a quarter of a
    second each time. Not in a single process: hypothesis would warn of what it cannot find."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        gc.disable()


def pytest_collection_finish(session: pytest.Session) -> None:
    if "PYTEST_XDIST_WORKER" in os.environ:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """First what takes longest, so that no process of `pytest -n` works alone at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    items.sort(key=lambda item: item.get_closest_marker("realtime") is None)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """`-n auto`: two more processes than cores, for two of them mostly wait for other processes."""
    return (os.cpu_count() or 1) + 2


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile once, in processes of `pytest -n` where the simulation's packages are installed. Hear
    Ctrl-C: a run in the background ignores it, and so would the commands that it starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if "PYTEST_XDIST_WORKER" in os.environ:
        with suppress(ModuleNotFoundError):
            from compiled_once import compile_once

            compile_once()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A loop that ran in this process leaves it a real-time process, which would starve the rest.

    Tests that measure time get three times as much processor time as the others (`pytest -n`). Not
    more: beside another program the others would starve.
    """
    measures_time = item.get_closest_marker("realtime") is not None
    if item.config.getoption("again") and not measures_time:
        pytest.fail("it failed before, and it measures no time: no second try", pytrace=False)
    if hasattr(os, "sched_setscheduler"):  # Linux
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if "PYTEST_XDIST_WORKER" in os.environ and not measures_time:
        os.nice(NICE - os.nice(0))  # for good: the tests that measure time were handed out first


class TogetherOrApart(LoadScopeScheduling):
    """Which tests one process of `pytest -n` runs together, told by their files.

    Those that measure time, one after another, in two groups that take about as long: `realtime`
    and `realtime("robot")`, the second with robots that break or hang; and those of a file with a
    fixture of module scope, which is then made once. The others go to whichever process is idle.
    """

    def _split_scope(self, nodeid: str) -> str:
        name = nodeid.partition("::")[0]
        text = (ROOT / name).read_text()
        if mark := re.search(r"^pytestmark = pytest\.mark\.(realtime.*)$", text, re.MULTILINE):
            return mark[1]
        return name if 'scope="module"' in text else nodeid


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> TogetherOrApart:
    """The plugin's own groups (`--dist loadgroup`) do nothing with pytest 9.2: xdist 3.8 writes
    them into an attribute that pytest no longer reads."""
    return TogetherOrApart(config, log)
