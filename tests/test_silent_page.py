"""What the operator page does where nothing is heard: STOP goes another way, old news is hidden."""

import time
from dataclasses import replace

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("fastapi", reason="the robot extra is not installed")
pytest.importorskip("websockets", reason="the robot extra is not installed")
pytest.importorskip("selenium", reason="the dev extra is not installed")

from selenium.webdriver.common.by import By

from browser import shown, visit
from operator_lab import FISH, KEY, ROOM
from support import until
from tailbeat.link import datagrams as link
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Frame
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import Numbers, State, Status
from tailbeat.operator.client import open_client
from tailbeat.operator.snapshot import snapshot


@pytest.mark.thorough
@pytest.mark.realtime
def test_stop_takes_another_way_where_the_open_connection_is_silent(chromium):
    """As after a break of the wireless link: it looks open, and holds back what is sent."""
    client, heard = open_client(("127.0.0.1", 0), ROOM), link.bind("127.0.0.1", 0)
    sender = Sender(KEY, heard, ("127.0.0.1", 9))
    sender.status = Status(State.RUN, Reason.ARMED, "so", 0, 0, 0, 0.0, Numbers())
    try:
        visit(chromium, client.url)
        seen = {**snapshot(sender, FISH, ROOM, sender.heard), "changes": ()}

        def runs() -> bool:
            client.show(seen, b"")
            time.sleep(0.05)
            return shown(chromium, "state").lower() == "run"

        until(runs)
        chromium.execute_script("WebSocket.prototype.send = () => {};")
        client.commands()
        time.sleep(1.3)  # no snapshot: the page has heard nothing for over a second
        chromium.find_element(By.ID, "stop").click()
        until(lambda: "stop" in [one["do"] for one in client.commands()], seconds=3.0)
    finally:
        client.close()
        heard.close()


def test_what_the_camera_saw_long_ago_is_not_shown_as_the_present():
    heard = link.bind("127.0.0.1", 0)
    sender = Sender(KEY, heard, ("127.0.0.1", 9))
    frame = Frame(sender.clock(), (0.0, 0.0, 0.0), (3.0, 4.0))
    sender.frames.append(frame)
    now = time.monotonic()
    found = snapshot(sender, FISH, ROOM, now)
    assert found["away"] == pytest.approx(5.0) and found["target"] == (3.0, 4.0)
    sender.frames[-1] = replace(frame, captured=frame.captured - 2 * SECOND)
    found = snapshot(sender, FISH, ROOM, now)
    assert found["away"] is None and found["target"] is None
    sender.target = (1.0, 0.0)  # the operator's own stays
    assert snapshot(sender, FISH, ROOM, now)["target"] == (1.0, 0.0)
    heard.close()
