"""The commands of the pages under Start, Your fish and How to, run as a reader would type them.

A block that needs a servo, a camera or a pool begins with `# needs hardware`. The quick verbs run
here in the order of the page; the rest runs in the slow test. Not run anywhere: trainings, which
take half an hour, and what needs their result.
"""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cv2", reason="the station extra is not installed")

from support import tailbeat

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MARK = "# needs hardware"
# The machine's own devices, and addresses and rights that only a robot has.
HARDWARE = re.compile(r"/dev/|192\.168\.|\bsudo\b|raspi-config")
QUICK = ("new-fish", "protocol", "tags", "camera --pictures", "calibrate", "key")
# Until Ctrl-C; half an hour each; with a policy of such a training.
NEVER = ("emulate", "station --replay", "train", "policy try runs/", "compare")
PAGES = sorted(
    page for room in ("start", "your-fish", "how-to") for page in DOCS.glob(f"{room}/*.md")
)
WHOLE = ("first-swim", "record", "calibrate-the-camera", "install-the-pi", "drive",
         "read-a-log-in-foxglove")  # fmt: skip
SHELL = """
tailbeat() {{ "{python}" -m tailbeat "$@"; code=$?; [ $code -le 1 ] || kill -TERM $$; }}
"""


def blocks(page: Path) -> list[str]:
    """The blocks of commands on a page."""
    return re.findall(r"^ *```sh\n(.*?)^ *```", page.read_text("utf-8"), re.M | re.S)


def lines(page: Path) -> Iterator[str]:
    """Commands of a page that need no hardware, continued lines joined."""
    for block in blocks(page):
        if not block.startswith(MARK):
            yield from re.sub(r" *\\\n\s*", " ", block).splitlines()


def told(page: Path, verbs: tuple[str, ...]) -> list[str]:
    """The page's commands of these verbs."""
    return [one for one in lines(page) if one.startswith(tuple(f"tailbeat {v}" for v in verbs))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_block_says_whether_it_needs_hardware(page):
    for block in blocks(page):
        assert bool(HARDWARE.search(block)) == block.startswith(MARK), block


@pytest.mark.thorough
@pytest.mark.parametrize("page", [p for p in PAGES if told(p, QUICK)], ids=lambda page: page.stem)
def test_quick_commands_work_as_written(page, tmp_path):
    for line in told(page, QUICK):
        done = tailbeat(*shlex.split(line)[1:], cwd=tmp_path)
        assert done.returncode == 0, (line, done.stderr)


def shown(text: str) -> set[tuple[str, str]]:
    """Names and values of tables with two columns."""
    return set(re.findall(r"^│ (\S.*?) +│ (\S.*?) +│$", text, re.M))


@pytest.mark.thorough
@pytest.mark.parametrize("verb", ["show", "swim"])
def test_the_tutorial_shows_what_its_commands_print(verb, tmp_path):
    """Of a fish whose description is an example: nothing is measured or trained."""
    page = DOCS / "your-fish" / "index.md"
    shutil.copy(ROOT / "examples" / "your-fish" / "my-fish.toml", tmp_path)
    (line,) = told(page, (verb,))
    after = page.read_text("utf-8").split(f"```sh\n{line}\n```", 1)[1]
    promised = shown(re.findall(r"```text\n(.*?)```", after, re.S)[0])
    done = tailbeat(*shlex.split(line)[1:], cwd=tmp_path)
    assert len(promised) >= 4 and not promised - shown(done.stdout)


def test_there_are_quick_commands_and_blocks_that_need_hardware():
    assert sum(len(told(page, QUICK)) for page in PAGES) >= 8
    assert sum(block.startswith(MARK) for page in PAGES for block in blocks(page)) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", WHOLE)
def test_a_page_works_from_top_to_bottom(name, tmp_path):
    """Exit code 1 passes: on a busy machine the fish may hold, and says so."""
    (page,) = DOCS.glob(f"*/{name}.md")
    left_out = set(told(page, NEVER))
    script = [one for one in lines(page) if one.startswith(("tailbeat", "until"))]
    text = SHELL.format(python=sys.executable) + "\n".join(x for x in script if x not in left_out)
    words = ["bash", "-c", f"{text}\nwait"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr[-2000:]
