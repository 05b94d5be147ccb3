"""The station's verb, and a drive that waits for orders: in processes, over real sockets."""

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("fastapi", reason="the robot extra is not installed")
pytest.importorskip("websockets", reason="the robot extra is not installed")

import websockets.sync.client as ws
from websockets.exceptions import InvalidMessage

from operator_lab import ROOM, SOON
from support import command, until
from tailbeat.cli import drive, station
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.reasons import Reason
from tailbeat.link.status import Numbers, State, Status
from tailbeat.operator.client import open_page
from tailbeat.operator.snapshot import body

pytestmark = pytest.mark.realtime

PULLEY = load_fish("pulley-fish")


def joined(page: str) -> ws.ClientConnection:
    """The page's stream. A busy machine's station may replace a slow server: then once more."""
    for _ in range(3):
        try:
            return ws.connect(f"{page.replace('http', 'ws')}live")
        except (InvalidMessage, OSError):
            time.sleep(1.0)
    raise AssertionError("the page's server ends every connection")


def test_the_laptop_answers_orders_and_stops_the_fish_when_it_ends(tmp_path: Path):
    """The test is the fish here: it asks, hears and reports over real sockets."""
    from tailbeat.link.status import status_datagram

    link.make_key(tmp_path / "fish.key")
    key, fish, probe = link.read_key(tmp_path / "fish.key"), link.bind("127.0.0.1", 0), None
    probe = link.bind("127.0.0.1", 0)
    there = probe.getsockname()
    probe.close()
    robot, listen = (f"{host}:{port}" for host, port in (fish.getsockname(), there))
    words = ["station", "--robot", robot, "--listen", listen, "--page", "127.0.0.1:0"]
    words += ["--key", str(tmp_path / "fish.key")]
    process = subprocess.Popen(command(*words), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    url = process.stdout.readline().split()[-1]
    to, count, orders = link.Receiver(key, ROOM), 0, list[link.Order]()

    def hear() -> None:
        nonlocal count
        count += 1
        status = Status(
            State.RUN, Reason.SWIMMING, "swimming", 0, 0, to.ordered.get(to.run, 0), 0.0, Numbers()
        )
        fish.sendto(link.ask_datagram(key, to.nonce, count, time.monotonic_ns()), there)
        fish.sendto(status_datagram(key, to.run, to.nonce, count, status), there)
        for data, _ in link.drain(fish):
            to.take(data, time.monotonic_ns())
        orders.extend(to.take_orders())

    try:
        until(lambda: hear() or to.clock.offset(time.monotonic_ns()) is not None)  # type: ignore[func-returns-value]
        page, token = url.split("#token=")
        with joined(page) as browser:
            browser.send(json.dumps({"do": "arm", "token": token}))
            until(lambda: hear() or orders == [link.Order.ARM])  # type: ignore[func-returns-value]
            assert "No camera given" in json.loads(browser.recv(SOON))["now"]["note"]
        process.send_signal(signal.SIGINT)
        until(lambda: hear() or link.Order.STOP in orders)  # type: ignore[func-returns-value]
        until(lambda: hear() or process.poll() == 0)  # type: ignore[func-returns-value]
        assert "run: swimming" in process.stdout.read()
    finally:
        process.kill()
        process.wait(10)
        process.stdout.close()
        fish.close()


@pytest.mark.thorough
def test_a_drive_waits_for_orders_and_ends_with_the_torque_off(tmp_path: Path):
    """All of it in processes of its own; a busy machine may refuse to arm, and says why."""
    words = ["drive", "pulley-fish-pool-generator", "--emulated", "--wait", "--page", "127.0.0.1:0",
             "--log", tmp_path / "a.mcap", "--json", tmp_path / "a.json"]  # fmt: skip
    process = subprocess.Popen(command(*words), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        page, token = process.stdout.readline().split()[-1].split("#token=")
        with ws.connect(f"{page.replace('http', 'ws')}live") as browser:

            def status() -> dict[str, Any]:
                browser.send("drawn")
                return json.loads(browser.recv(SOON))["now"]["status"] or {}

            until(lambda: status().get("reason") == "not armed yet")
            time.sleep(2.0)  # by itself it would arm after one
            assert status()["state"] == "disarmed"
            browser.send(json.dumps({"do": "arm", "token": token}))
            until(lambda: status()["reason"] != "not armed yet")
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
        assert process.returncode in (0, 1) and "Traceback" not in said
        assert json.loads((tmp_path / "a.json").read_text())["rejected_datagrams"] == {}
    finally:
        process.kill()
        process.wait(10)


def test_what_a_console_cannot_have_is_one_sentence(tmp_path: Path):
    words = {
        "servo": "a",
        "imu": "b",
        "listen": "127.0.0.1:1",
        "station": "127.0.0.1:2",
        "key": tmp_path,
    }
    with pytest.raises(BadInput, match="the station shows it"):
        drive.drive("p", tmp_path / "a", page="127.0.0.1:0", **words)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="--camera needs --calibration"):
        station.station("127.0.0.1:1", tmp_path, "127.0.0.1:2", camera="/dev/video0")
    with pytest.raises(BadInput, match="give host:port"):
        open_page("8080")


def test_the_fish_is_drawn_where_its_tag_is_and_bends_to_the_motor_s_side():
    straight, left = body(PULLEY, (1.0, 0.5, 0.0), 0.0), body(PULLEY, (1.0, 0.5, 0.0), 0.5)
    nose, fin = straight[0], straight[-1]
    tag = PULLEY.tracked[0]
    assert nose[0] == pytest.approx(1.0 - tag + 0.12) and nose[1] == pytest.approx(0.5)
    assert fin[0] < nose[0] - 0.4 and left[-1][1] > fin[1] + 0.02
