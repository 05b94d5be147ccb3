"""A key is private from its first byte on, and no copy of it is left anywhere.

A process makes a key while a hook of the interpreter looks at the folder before each file that is
opened, renamed, or given another mode. It may also be killed there, as by a power cut.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tailbeat.files import BadInput
from tailbeat.link.datagrams import KEY_BYTES, make_key, read_key
from tailbeat.processes import OWNER, temporary

MAKES = """
import json, os, signal, sys
from pathlib import Path
from tailbeat.link.datagrams import make_key

folder, last = Path(sys.argv[1]), int(sys.argv[2])
seen, inside = [], False

def look(event, words):
    global inside
    if inside or event not in ("open", "os.chmod", "os.rename", "os.link", "os.remove"):
        return
    inside = True
    seen.append([(one.name, one.stat().st_mode & 0o777) for one in folder.iterdir()])
    inside = False
    if len(seen) == last:
        os.kill(os.getpid(), signal.SIGKILL)

os.umask(0)
sys.addaudithook(look)
make_key(folder / "fish.key")
count = len(seen)
look("open", ())
print(json.dumps([count, seen]))
"""


def made(folder: Path, last: int = 0) -> "subprocess.CompletedProcess[str]":
    """Make a key in a folder with an open umask; killed before the operation `last`, if any."""
    words = [sys.executable, "-c", MAKES, str(folder), str(last)]
    return subprocess.run(words, capture_output=True, text=True, timeout=60)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Number of operations, and the files with their modes before each and in the end."""
    done = made(tmp_path_factory.mktemp("keys"))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_nobody_else_may_read_the_key_at_any_moment(watched):
    _, seen = watched
    assert seen[-1] == [["fish.key", 0o600]]
    open_to_others = [(name, oct(mode)) for files in seen for name, mode in files if mode & 0o077]
    assert not open_to_others


def test_a_crash_at_any_moment_leaves_no_copy_of_the_key(watched, tmp_path):
    for last in range(1, watched[0] + 1):
        folder = tmp_path / str(last)
        folder.mkdir()
        assert made(folder, last).returncode < 0
        assert [one.name for one in folder.iterdir()] in ([], ["fish.key"]), last


def test_a_folder_that_takes_no_file_is_one_sentence_and_nothing_is_left(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="choose a folder you can write to"):
        make_key(tmp_path / "file" / "fish.key")
    with pytest.raises(BadInput, match="exists already"):
        make_key(tmp_path / "file")
    make_key(tmp_path / "new" / "fish.key")
    assert len(read_key(tmp_path / "new" / "fish.key")) == KEY_BYTES


def test_a_disk_that_takes_no_byte_leaves_no_file(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(BadInput, match="File too large; nothing is left there"):
            make_key(tmp_path / "fish.key")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


STAYS = """
import os, signal, sys, time
from pathlib import Path
from tailbeat.link.datagrams import make_key
from tailbeat.processes import temporary

with temporary() as folder:
    make_key(Path(folder) / "rig.key")
    print(folder, flush=True)
    time.sleep(600)
"""


def test_a_key_of_emulated_devices_that_a_crash_left_is_removed_at_the_next_start(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)  # where the standard library keeps the answer
    words = [sys.executable, "-c", STAYS]
    both = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    dead = both[0]
    try:
        left, used = (Path(str(one.stdout and one.stdout.readline()).strip()) for one in both)
        dead.kill()
        dead.wait(10)
        for folder in (left, used):
            os.utime(folder / OWNER, (1.0, 1.0))  # old enough to be looked at
        assert (left / "rig.key").exists()
        with temporary() as name:
            assert not left.exists() and (used / "rig.key").exists() and Path(name).is_dir()
        assert not Path(name).exists()
    finally:
        for one in both:
            one.kill()
            one.communicate(timeout=10)
