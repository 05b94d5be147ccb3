"""SECURITY.md line by line: each claim names a test, and each test named is there.

Here are the claims that no other file tests. The page is a real server's, the test its station.
"""

import ast
import inspect
import json
import os
import re
import stat
import struct
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="the station extra is not installed")
pytest.importorskip("websockets", reason="the station extra is not installed")

import websockets.sync.client as ws

from tailbeat.cli.station import station
from tailbeat.files import BadInput
from tailbeat.link.datagrams import Frame, bind, pose_datagram
from tailbeat.operator.client import OperatorClient, announce, listen, open_client, open_page
from tailbeat.operator.server import PAGES
from tailbeat.processes import temporary

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src" / "tailbeat").rglob("*.py"))
TEXT = (ROOT / "SECURITY.md").read_text("utf-8")
CLAIM = re.compile(r"^\|.*\|\s*`(\w+)::(\w+)`\s*\|$", re.M)
CLAIMS = CLAIM.findall(TEXT)


# ---- the page of claims -------------------------------------------------------------------------


def functions_of(name: str) -> set[str]:
    tree = ast.parse((ROOT / "tests" / f"{name}.py").read_text("utf-8"))
    return {one.name for one in tree.body if isinstance(one, ast.FunctionDef)}


def claim_rows(text: str) -> list[str]:
    """The rows of tables whose head ends with "test"."""
    rows, inside = [], False
    for line in text.splitlines():
        if line.startswith("|"):
            inside = inside or line.endswith("| test |")
            if inside and not line.endswith("| test |") and not set(line) <= set("|- "):
                rows.append(line)
        else:
            inside = False
    return rows


def test_every_claim_names_a_test_that_there_is():
    assert len(CLAIMS) > 40
    assert [row for row in claim_rows(TEXT) if not CLAIM.match(row)] == []
    missing = [f"{file}::{name}" for file, name in CLAIMS if name not in functions_of(file)]
    assert not missing


def test_every_test_of_this_file_is_named_by_a_claim():
    named = {name for file, name in CLAIMS if file == Path(__file__).stem}
    ours = {name for name in functions_of(Path(__file__).stem) if name.startswith("test_")}
    assert ours - named == {
        "test_every_claim_names_a_test_that_there_is",
        "test_every_test_of_this_file_is_named_by_a_claim",
        "test_a_claim_without_a_test_is_found",
    }


def test_a_claim_without_a_test_is_found():
    text = "| he cannot | because | test |\n|---|---|---|\n| fly | he has no wings | |\n"
    assert claim_rows(text) == ["| fly | he has no wings | |"] and not CLAIM.match("| fly | |")


# ---- on the network -----------------------------------------------------------------------------


def test_the_page_is_for_this_machine_unless_said_otherwise():
    assert inspect.signature(station).parameters["page"].default.startswith("127.0.0.1:")


def test_no_part_listens_on_all_networks():
    with pytest.raises(BadInput, match=r"--page '0\.0\.0\.0': this means all networks"):
        open_page("0:0")
    for host in ("", "0.0.0.0"):
        with pytest.raises(BadInput, match="this means all networks"):
            listen((host, 0))
        with pytest.raises(BadInput, match=f"link address {host!r}: this means all networks"):
            bind(host, 0)


def test_poses_are_readable_on_the_network():
    frame = Frame(1, (0.5, -0.25, 1.5), None)
    assert struct.pack("<3f", 0.5, -0.25, 1.5) in pose_datagram(bytes(32), 1, 2, 3, [frame])


def test_a_page_for_the_network_warns(page, monkeypatch):
    assert len(announce(page)) == 1
    monkeypatch.setattr("tailbeat.operator.client.is_local", lambda host: False)
    assert "unencrypted" in announce(page)[1] and "read the token" in announce(page)[1]


# ---- at the page --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page() -> Iterator[OperatorClient]:
    made = open_client(("127.0.0.1", 0), (5.5, 2.7))
    yield made
    made.close()


def live(page: OperatorClient) -> ws.ClientConnection:
    return ws.connect(page.url.partition("#")[0].replace("http", "ws") + "live")


def said(page: OperatorClient, browser: ws.ClientConnection) -> list[str]:
    """What the server says with the next snapshot."""
    page.show({}, b"")
    message = json.loads(browser.recv(10))
    browser.send("drawn")
    return list(message["said"])


def test_without_the_token_nothing_but_stop_reaches_the_station(page):
    words: list[dict[str, object]] = [
        {"do": do} for do in ("arm", "swim", "disarm", "tag", "hello", "ready", "alive")
    ]
    words += [{"do": "target", "at": [0, 0]}, {"do": "arm", "token": page.token[:-1]}]
    with live(page) as browser:
        for one in words:
            browser.send(json.dumps(one))
            found: list[str] = []
            while not found:
                found = said(page, browser)
            assert found[0].startswith("refused: wrong token"), one
        page.commands(0.2)
        assert not page.commands()


def test_whoever_reaches_the_page_may_watch_and_stop(page):
    with live(page) as browser:
        page.show({"status": "seen"}, b"")
        while json.loads(browser.recv(10))["now"] != {"status": "seen"}:
            browser.send("drawn")
        browser.send('{"do": "stop"}')
        found: list[dict[str, object]] = []
        while not found:
            found = page.commands(10.0)
    assert [one["do"] for one in found] == ["stop"]


def test_a_token_is_of_96_random_bits_and_new_each_time(page):
    other = open_client(("127.0.0.1", 0), (5.5, 2.7))
    other.close()
    assert other.token != page.token
    assert len(page.token) == len(other.token) == 16  # 6 bits a character


def get(page: OperatorClient, path: str) -> tuple[int, dict[str, str]]:
    host, port = page.listening.getsockname()
    asked = HTTPConnection(host, port, timeout=10)
    asked.request("GET", path)
    answer = asked.getresponse()
    asked.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}


def test_the_page_s_server_gives_no_other_file(page):
    assert len(PAGES) == 7
    for path in ("/server.py", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/docs",
                 "/openapi.json", "/redoc", "/stop", "/page.css/../server.py"):  # fmt: skip
        assert get(page, path)[0] in (404, 405), path


def test_page_and_picture_forbid_frames_and_other_sites(page):
    page.show({}, b"\xff\xd8")
    with live(page) as browser:
        said(page, browser)  # so the picture is there
    for path in (*PAGES, "/camera.jpg"):
        status, headers = get(page, path)
        policy = headers["content-security-policy"]
        assert status == 200, path
        assert "default-src 'none'; script-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy and "unsafe" not in policy
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"  # the address holds the token


# ---- files from others --------------------------------------------------------------------------


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """Calls in a file, with the name that is called, like `torch.load`."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def test_only_searches_of_an_identification_are_unpickled():
    loaded = {path.relative_to(ROOT / "src" / "tailbeat").as_posix()
              for path in SOURCES for name, _ in calls(path)
              if name in ("pickle.loads", "pickle.load", "pickle.Unpickler")}  # fmt: skip
    assert loaded == {"identify/search.py", "identify/polish.py"}


@pytest.mark.thorough
def test_weights_and_arrays_are_read_without_code():
    found = [(name, {word.arg: ast.unparse(word.value) for word in call.keywords})
             for path in SOURCES for name, call in calls(path)
             if name in ("torch.load", "np.load", "numpy.load")]  # fmt: skip
    assert found
    for name, words in found:
        assert words.get("allow_pickle", "False") == "False", name
        assert name != "torch.load" or words["weights_only"] == "True"
    assert not [
        name for path in SOURCES for name, _ in calls(path) if name in ("eval", "exec", "os.system")
    ]


# ---- with a login -------------------------------------------------------------------------------


def test_neither_token_nor_key_is_in_a_command_line(page):
    lines = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            lines.append((folder / "cmdline").read_bytes())
        except OSError:
            continue  # it has ended
    assert any(b"tailbeat.operator.server" in line for line in lines)
    assert not [line for line in lines if page.token.encode() in line]
    environment = Path(f"/proc/{page.process.pid}/environ").read_bytes()
    assert page.token.encode() not in environment


def test_a_temporary_folder_is_private():
    before = os.umask(0)
    try:
        with temporary() as folder:
            assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700
    finally:
        os.umask(before)
