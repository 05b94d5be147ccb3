"""Strangers at the operator page: names, crowds, slow requests, odd messages.

A real server process and real sockets; the test is the station. Strangers come from addresses of
this machine's own, 127.0.0.x.
"""

import json
import os
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection

import pytest

pytest.importorskip("fastapi", reason="the station extra is not installed")
pytest.importorskip("websockets", reason="the station extra is not installed")

import websockets.sync.client as ws
from websockets.exceptions import ConnectionClosed

from tailbeat.operator.client import OperatorClient, allowed_hosts, open_client
from tailbeat.operator.door import HURRY

pytestmark = pytest.mark.realtime

ROOM, HERE, THERE = (5.5, 2.7), "127.0.0.1", "127.0.0.9"
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "
UPGRADE = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
           "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")  # fmt: skip
FILES = 1024  # open files that a process may have on many machines


@pytest.fixture
def page() -> Iterator[OperatorClient]:
    made = open_client((HERE, 0), ROOM)
    assert made.process is not None
    hard = resource.prlimit(made.process.pid, resource.RLIMIT_NOFILE)[1]
    resource.prlimit(made.process.pid, resource.RLIMIT_NOFILE, (FILES, hard))
    yield made
    made.close()


def port(page: OperatorClient) -> int:
    return int(page.listening.getsockname()[1])


def live(page: OperatorClient) -> str:
    return f"ws://{HERE}:{port(page)}/live"


def connect(page: OperatorClient, origin: str = HERE, first: bytes = b"") -> socket.socket:
    made = socket.create_connection((HERE, port(page)), 10, source_address=(origin, 0))
    with suppress(ConnectionError):  # one too many
        made.sendall(first)
    return made


def is_open(made: socket.socket) -> bool:
    """Whether the server has not closed it."""
    made.settimeout(0.0)
    try:
        while made.recv(1 << 16):
            pass
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def post_stop(page: OperatorClient, **headers: str) -> tuple[int, float]:
    """Status of the answer to STOP, and how long it took [s]."""
    began = time.monotonic()
    asked = HTTPConnection(HERE, port(page), timeout=30)
    asked.request("POST", "/stop", headers=headers)
    status = asked.getresponse().status
    asked.close()
    return status, time.monotonic() - began


@contextmanager
def crowd(page: OperatorClient, origin: str, count: int = 2000) -> Iterator[list[socket.socket]]:
    """Connections that say nothing, half a header, or are pages that never draw."""
    live = "\r\n".join(["GET /live HTTP/1.1", f"Host: {HERE}", *UPGRADE, "", ""]).encode()
    firsts = (b"", HALF, live)
    with ExitStack() as stack:
        made = [connect(page, origin, firsts[k % 3]) for k in range(count)]
        for one in made:
            stack.enter_context(one)
        yield made


@pytest.fixture
def many_files() -> Iterator[None]:
    """The test itself needs more open files than the server."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= before[1] < 4096:
        pytest.skip(f"this machine allows {before[1]} open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(before[0], 4096), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


# ---- crowds -------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("origin", [HERE, THERE])
def test_stop_is_served_within_a_second_beside_2000_idle_connections(page, many_files, origin):
    with crowd(page, origin) as made:
        for _ in range(3):
            status, took = post_stop(page)
            assert status == 200 and took < 1.0
        began = time.monotonic()
        with ws.connect(live(page)) as browser:
            browser.send('{"do": "stop"}')
            stops = 0
            while stops < 4:
                stops += sum(one["do"] == "stop" for one in page.commands(1.0))
                assert time.monotonic() - began < 1.0
        assert sum(map(is_open, made)) <= 64
        assert open_files(page) < 300
    assert page.process.poll() is None


def open_files(page: OperatorClient) -> int:
    assert page.process is not None
    return len(os.listdir(f"/proc/{page.process.pid}/fd"))


@pytest.mark.thorough
def test_strangers_of_another_address_do_not_close_the_operator_s_page(page, many_files):
    with ws.connect(live(page)) as browser:
        page.show({}, b"")
        browser.recv(10)
        with crowd(page, THERE):
            browser.send("drawn")
            page.show({}, b"")
            assert "now" in browser.recv(10)


@pytest.mark.thorough
def test_stop_is_served_while_strangers_connect_without_end(page):
    """A stranger that opens connections as fast as it can, from its own address."""
    over, opened = threading.Event(), [0]

    def flood() -> None:
        while not over.is_set():
            with suppress(OSError), connect(page, THERE, HALF):
                opened[0] += 1

    strangers = [threading.Thread(target=flood, daemon=True) for _ in range(4)]
    for one in strangers:
        one.start()
    try:
        took = [post_stop(page)[1] for _ in range(10)]
    finally:
        over.set()
        for one in strangers:
            one.join(10)
    assert opened[0] > 100 and sorted(took)[5] < 0.5 and max(took) < 2.0, took


# ---- slow requests ------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("drip", [False, True])
def test_a_request_that_does_not_end_is_closed_after_five_seconds(page, drip):
    with connect(page, first=HALF) as slow:
        began = time.monotonic()
        while is_open(slow):
            assert time.monotonic() - began < HURRY + 3
            time.sleep(0.1)
            if drip:
                with suppress(OSError):
                    slow.sendall(b"x")
        assert time.monotonic() - began > HURRY - 0.5


def test_a_body_that_does_not_come_is_not_waited_for(page):
    head = b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99\r\n\r\n"
    with connect(page, first=head) as slow:
        slow.settimeout(3)
        assert slow.recv(100).startswith(b"HTTP/1.1 200")
    assert page.commands(3.0) == [{"do": "stop", "asker": ""}]


def test_a_connection_serves_one_request_and_a_page_stays(page):
    with connect(page, first=b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 2) as asked:
        asked.settimeout(5)
        heard = b""
        while came := asked.recv(1 << 16):
            heard += came
        assert heard.count(b"HTTP/1.1 200") == 1 and b"connection: close" in heard.lower()
    with ws.connect(live(page)) as browser:
        time.sleep(HURRY + 1)
        page.show({}, b"")
        assert "now" in browser.recv(10)


def test_the_server_ends_at_once_beside_connections_that_say_nothing(capfd):
    page = open_client((HERE, 0), ROOM)
    with connect(page) as silent, connect(page, first=HALF), ws.connect(live(page)):
        assert is_open(silent) and post_stop(page)[0] == 200
        began = time.monotonic()
        page.close()
        assert time.monotonic() - began < 2.5 and not is_open(silent)
    assert capfd.readouterr().err == ""


# ---- names --------------------------------------------------------------------------------------


def upgraded(page: OperatorClient, *headers: str) -> socket.socket:
    """A connection that asked to become a page's WebSocket; what the server answers is not read."""
    words = ["GET /live HTTP/1.1", *headers, *UPGRADE]
    return connect(page, first="".join(f"{one}\r\n" for one in (*words, "")).encode())


def refused(page: OperatorClient, host: str, origin: str | None = None) -> bool:
    """Whether STOP of a page under this name is refused, by both ways."""
    headers = {"Host": host} | ({"Origin": origin} if origin else {})
    status, _ = post_stop(page, **headers)
    with upgraded(page, *(f"{name}: {value}" for name, value in headers.items())) as asked:
        asked.settimeout(5)
        opened = asked.recv(100).startswith(b"HTTP/1.1 101")
    assert opened == (status == 200)
    return not opened


def test_a_page_for_the_network_answers_to_its_address_and_this_machine_s_name_alone(monkeypatch):
    """A site that points its own name to this machine would else press STOP (DNS rebinding)."""
    monkeypatch.setattr("tailbeat.operator.client.is_local", lambda host: False)
    page = open_client((HERE, 0), ROOM)
    at, name = port(page), socket.gethostname().lower().removesuffix(".local")
    try:
        for good in (f"{HERE}:{at}", HERE, f"{name}:{at}", f"{name.upper()}.local:{at}"):
            assert not refused(page, good), good
        for bad in (
            "evil.example",
            f"evil.example:{at}",
            f"localhost:{at}",
            f"127.0.0.2:{at}",
            f"{name}.evil.example:{at}",
            f"www.{name}:{at}",
            "",
            "[",
            "[::1",
            "*",
        ):
            assert refused(page, bad, f"http://{bad}"), bad
    finally:
        page.close()


def test_a_page_of_this_machine_answers_to_localhost_too(page):
    assert allowed_hosts(page.listening) == [HERE, "localhost"]
    assert not refused(page, f"localhost:{port(page)}")
    assert refused(page, f"{socket.gethostname()}.example:{port(page)}")


def test_only_its_own_page_may_order_not_one_of_another_site(page):
    own = f"{HERE}:{port(page)}"
    assert not refused(page, own, f"http://{own}")
    for origin in ("http://evil.example", f"http://{HERE}:1", "null", "file://", "http://[",
                   f"http://{own}.evil.example", f"ftp://{own}"):  # fmt: skip
        assert refused(page, own, origin), origin


# ---- odd messages -------------------------------------------------------------------------------


def answers(browser: ws.ClientConnection, page: OperatorClient) -> list[str]:
    """What the server said to this browser by the next snapshot."""
    page.show({}, b"")
    said = json.loads(browser.recv(10))["said"]
    browser.send("drawn")
    return list(said)


def odd(token: str) -> list[str | bytes]:
    target = f'{{"do": "target", "token": "{token}", "at": '
    return [
        '{"do": "arm", "token": "\\ud800"}', "[" * 1990, '{"do":' * 330, "9" * 1990, "null", "[]",
        '"do"', "5", "", "{}", '{"do": ["stop"]}', '{"do": "arm", "token": 5}', '{"do": null}',
        '{"do": "swim", "do": "stop"}', b'{"do": "stop"}', b"\xff\x00", b"",
        f"{target}[1e999, 0]}}", f"{target}[NaN, 0]}}", f"{target}[-Infinity, 0]}}",
        f"{target}[{'9' * 400}, 0]}}", f"{target}[true, false]}}", f"{target}{{}}}}",
        f'{target}[0, 0], "at": [1, 1]}}', f'{{"do": "arm\\u0000", "token": "{token}"}}',
    ]  # fmt: skip


def test_an_odd_message_is_one_refusal_and_the_page_goes_on(capfd):
    page = open_client((HERE, 0), ROOM)
    try:
        with ws.connect(live(page)) as browser:
            for message in odd(page.token):
                browser.send(message)
                browser.send(json.dumps({"do": "hello", "token": page.token}))  # it goes on
                said: list[str] = []
                while said[-1:] != ["token accepted"]:
                    said += answers(browser, page)
                assert len(said) == 2 and said[0].startswith("refused: "), (message, said)
        assert not page.commands()
    finally:
        page.close()
    assert capfd.readouterr().err == ""


def frame(kind: int, data: bytes) -> bytes:
    """A short WebSocket frame of a browser (RFC 6455, section 5.2), masked with zeros."""
    return bytes([0x80 | kind, 0x80 | len(data), 0, 0, 0, 0]) + data


def ends(asked: socket.socket) -> None:
    """Wait until the server closes this connection."""
    asked.settimeout(3)
    with suppress(ConnectionError):
        while asked.recv(1 << 16):
            pass


def test_what_is_no_message_at_all_closes_its_connection_without_a_traceback(capfd):
    page = open_client((HERE, 0), ROOM)
    frames = frame(1, b"\xff\xfe"), frame(3, b"x"), frame(0, b"x"), bytes([0x81, 1]) + b"x"
    upgrade = b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\n"
    heads = [b"\x16\x03\x01\x02\x00\x01\x00", b"GET / HTTP/1.1\r\n\r\n", b"x" * 70_000,
             b"GET / HTTP/1.1\r\nHost: a\r\nHost: 127.0.0.1\r\n\r\n",
             upgrade + b"Upgrade: h2c\r\n\r\n", upgrade + b"Upgrade: websocket\r\n\r\n",
             upgrade + b"Upgrade: websocket\r\nSec-WebSocket-Key: x\r\n"
             b"Sec-WebSocket-Version: 99\r\n\r\n",
             b"GET /%ff%00 HTTP/1.1\r\nHost: \xff\r\n\r\n"]  # fmt: skip
    try:
        for words in heads:
            with connect(page, first=words) as asked:
                ends(asked)
        for words in frames:
            with upgraded(page, f"Host: {HERE}") as asked:
                assert b"101 Switching" in asked.recv(1 << 16)
                asked.sendall(words)
                ends(asked)
        with ws.connect(live(page)) as browser, pytest.raises(ConnectionClosed):
            browser.send("x" * 2001)
            browser.recv(10)
        assert post_stop(page)[0] == 200
    finally:
        page.close()
    assert capfd.readouterr().err == ""


def test_a_browser_that_asks_without_end_and_reads_nothing_gets_the_last_answers(page):
    with ws.connect(live(page)) as browser:
        for _ in range(1000):
            browser.send('{"do": "arm", "token": "x"}')
        browser.send(json.dumps({"do": "hello", "token": page.token}))
        time.sleep(1.0)
        said = answers(browser, page)
        assert len(said) <= 8 and said[-1] == "token accepted"
