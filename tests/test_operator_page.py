"""The operator's page in a real browser, with the emulated bench and the robot's loop behind it."""

import json
import math
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("fastapi", reason="the robot extra is not installed")
pytest.importorskip("websockets", reason="the robot extra is not installed")
pytest.importorskip("selenium", reason="the dev extra is not installed")

import websockets.sync.client as ws
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By

from browser import shown, visit
from operator_lab import FISH, JPEG, KEY, ROOM, SOON, TAG, Lab, ask, live, near, open_lab
from support import until
from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import Numbers, State, Status
from tailbeat.operator import snapshot as snapshots
from tailbeat.operator.client import announce, is_local, open_client
from tailbeat.operator.snapshot import snapshot

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    with open_lab() as made:
        yield made


@pytest.fixture
def page(lab: Lab, chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """The page with the token, at a swimming fish; in the end the browser has nothing to say."""
    lab.swim()
    visit(chromium, lab.client.url)
    shows(chromium, State.RUN)
    until(lambda: not chromium.find_element(By.ID, "key").is_displayed())  # the token was taken
    yield chromium
    assert chromium.get_log("browser") == []


def shows(browser: webdriver.Chrome, state: State) -> None:
    until(lambda: shown(browser, "state").lower() == state.value)


def scale(browser: webdriver.Chrome) -> float:
    """Pixels of a metre on the map."""
    box = browser.execute_script(
        "const m = document.getElementById('map');"
        "return [m.getBoundingClientRect().width, m.viewBox.baseVal.width]"
    )
    return box[0] / box[1]


# ---- in the browser -----------------------------------------------------------------------------


def test_the_state_its_reason_and_the_readings_are_shown(lab, page):
    assert shown(page, "reason") == "swimming"
    assert "target by its tag at x 1.50, y 0.50" in shown(page, "where")
    until(lambda: "30 °C" in shown(page, "gauges") and "12.0 V" in shown(page, "gauges"))
    readings = shown(page, "gauges")
    for name in ("Pose age", "Poses lost, status lost", "Loop late", "Periods missed",
                 "inside the band", "Servo current", "Clock error"):  # fmt: skip
        assert name in readings
    assert page.find_element(By.ID, "fish").get_attribute("d").count("Q") > 10
    assert shown(page, "dark") == "No camera picture."


def test_state_changes_are_listed_with_the_time_of_day_newest_first(lab, page):
    def rows() -> list[list[str]]:
        found = page.find_elements(By.CSS_SELECTOR, "#changes li")
        return [one.text.split("\n") for one in found]

    until(lambda: [row[1:] for row in rows()][:1] == [["RUN", "swimming"]], what=rows)
    assert ["ARMED", "armed"] in [row[1:] for row in rows()]
    times = [time.strptime(row[0], "%H:%M:%S") for row in rows()]
    assert times == sorted(times, reverse=True) and 2 <= len(times) <= 8
    assert abs(time.mktime(time.localtime()) - lab.client.changes[-1].at) < 300


def test_a_target_dragged_by_mouse_is_where_the_fish_swims_to(lab, page):
    metre, target = scale(page), page.find_element(By.CSS_SELECTOR, "#target .touch")
    drag = ActionChains(page).move_to_element(target).click_and_hold()
    for _ in range(4):
        drag.move_by_offset(round(-0.5 * metre), round(0.25 * metre))
    drag.release().perform()
    x, y = TAG[0] - 4 * round(0.5 * metre) / metre, TAG[1] - 4 * round(0.25 * metre) / metre
    until(lambda: near(lab, x, y))
    assert lab.loop.safety_status.state is State.RUN and "by hand" in shown(page, "where")
    until(lambda: abs(lab.loop.decided_on[0, 3] - x) < 0.03)  # the policy's input
    page.find_element(By.ID, "tag").click()
    until(lambda: near(lab, *TAG))


def test_a_target_dragged_by_finger_does_the_same_and_stays_in_the_pool(lab, page):
    metre = scale(page)
    box = page.execute_script(
        "const b = document.querySelector('#target .ring').getBoundingClientRect();"
        "return [b.x + b.width / 2, b.y + b.height / 2]"
    )
    page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        for kind, dx in (("touchStart", 0), ("touchMove", -0.4), ("touchMove", -0.8)):
            place = {"x": box[0] + dx * metre, "y": box[1]}
            page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [place]})
        until(lambda: near(lab, TAG[0] - 0.8, TAG[1]))
        far = {"x": 1.0, "y": box[1]}
        page.execute_cdp_cmd(
            "Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [far]}
        )
        page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        until(lambda: near(lab, -ROOM[0] / 2, TAG[1]))
    finally:
        page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def test_a_target_that_is_dragged_is_sent_all_the_time_and_its_motion_is_shown(lab, page):
    metre, target = scale(page), page.find_element(By.CSS_SELECTOR, "#target .touch")
    asked, attend = list[tuple[float, Any]](), lab.client.commands

    def commands(patience: float = 0.0) -> list[dict[str, Any]]:
        found = attend(patience)
        asked.extend((time.monotonic(), one["at"]) for one in found if one["do"] == "target")
        return found

    lab.client.commands = commands
    try:
        drag = ActionChains(page, duration=60).move_to_element(target).click_and_hold()
        for _ in range(40):
            drag.move_by_offset(-round(0.03 * metre), 0)
        drag.perform()  # the button is still held
        x = TAG[0] - 40 * round(0.03 * metre) / metre
        until(lambda: near(lab, x, TAG[1]), what=lambda: (x, lab.target, asked[-3:]), seconds=20)
        got = {tuple(place) for _, place in asked}
        rate = (len(asked) - 1) / (asked[-1][0] - asked[0][0])
        assert len(got) > 5, got  # not only where it is let go
        assert rate < 25  # a second, about twenty at most
        ActionChains(page).release().perform()
    finally:
        lab.client.commands = attend
    until(lambda: "moves at" not in shown(page, "where"))  # it rests
    assert page.find_element(By.ID, "motion").get_attribute("d") == ""


def test_the_target_s_velocity_and_the_distance_of_the_last_minute_are_shown(lab, page):
    began, ended = time.monotonic(), threading.Event()

    def lead() -> None:
        """As a leader by the clock does: to the left at 0.1 m/s."""
        while not ended.wait(0.01):
            lab.rig.station.sender.target = (1.0 - 0.1 * (time.monotonic() - began), 0.5)

    def arrow() -> tuple[float, ...]:
        numbers = re.findall(r"[-.\d]+", page.find_element(By.ID, "motion").get_attribute("d"))
        return tuple(map(float, numbers[2:4]))  # M0 0Lx y

    leading = threading.Thread(target=lead, daemon=True)
    leading.start()
    try:  # the jump from the place before also passes through 0.1 m/s, to the right
        until(lambda: arrow() == pytest.approx((-0.2, 0.0), abs=0.05)
              and re.search(r"moves at 0\.(09|10|11) m", shown(page, "where")), arrow)  # fmt: skip
    finally:
        ended.set()
        leading.join()
    until(lambda: page.find_element(By.ID, "curve").get_attribute("d").count("L") > 5)

    def apart() -> float:
        """The shown distance less the robot's, which may be newer or older than the page."""
        fish = lab.loop.poses.seen[-1].fish[:2]
        return float(shown(page, "away").removesuffix(" m")) - math.dist(fish, lab.target)

    until(lambda: abs(apart()) < 0.05, what=apart)
    assert "60 s" in page.find_element(By.ID, "distance").text


def test_arrow_keys_move_the_target_too(lab, page):
    page.execute_script("document.getElementById('target').focus()")
    ActionChains(page).send_keys(Keys.ARROW_LEFT * 4 + Keys.ARROW_UP * 2).perform()
    until(lambda: near(lab, TAG[0] - 0.2, TAG[1] + 0.1))


def test_the_buttons_arm_swim_and_disarm(lab, page):
    for name, state in (("disarm", State.DISARMED), ("arm", State.ARMED), ("swim", State.RUN)):
        button = page.find_element(By.ID, name)
        until(button.is_enabled)
        lab.bring(name, state, button.click)
        until(lambda: lab.torque == (lab.loop.safety_status.state is not State.DISARMED))
        shows(page, state)


@pytest.mark.parametrize("how", ["button", "space", "space in the token's field"])
def test_stop_takes_the_torque_off_even_from_a_page_that_may_only_watch(lab, chromium, how):
    lab.swim()
    visit(chromium, lab.page)  # no token
    shows(chromium, State.RUN)
    if how == "button":
        chromium.find_element(By.ID, "stop").click()
    else:
        where = "token" if "field" in how else "reason"
        field_ = chromium.find_element(By.ID, where) if "field" in how else None
        keys = ActionChains(chromium)
        (keys.click(field_) if field_ else keys).send_keys(" ").perform()
    lab.stands(State.STOP)
    until(lambda: lab.torque == 0)
    assert lab.loop.safety_status.text == "stop asked by the operator page"
    shows(chromium, State.STOP)
    assert "asked by the operator page" in shown(chromium, "reason")
    assert chromium.get_log("browser") == []


@pytest.mark.thorough
def test_a_fish_that_is_armed_again_after_a_stop_is_not_stopped_again(chromium):
    """The test is the station: the fish follows STOP, and is armed again within three seconds."""
    client, heard = open_client(("127.0.0.1", 0), ROOM), link.bind("127.0.0.1", 0)
    found = list[str]()
    sender = Sender(KEY, heard, ("127.0.0.1", 9))

    def shows_too(state: State) -> bool:
        sender.status = Status(state, Reason.ARMED, "so", 0, 0, 0, 0.0, Numbers())
        sender.heard = time.monotonic()
        client.show({**snapshot(sender, FISH, ROOM, sender.heard), "changes": ()}, b"")
        time.sleep(0.02)
        found.extend(one["do"] for one in client.commands())
        return shown(chromium, "state").lower() == state.value

    try:
        visit(chromium, client.url)
        disarm = chromium.find_element(By.ID, "disarm")
        until(lambda: shows_too(State.TEST) and disarm.is_enabled())
        assert chromium.find_element(By.ID, "icon").get_attribute("d").startswith("M")
        chromium.find_element(By.ID, "stop").click()
        until(lambda: shows_too(State.TEST) and found.count("stop") > 1)  # it is repeated
        found.clear()
        until(lambda: shows_too(State.RUN) and found.count("stop") > 1)
        until(lambda: shows_too(State.STOP))
        found.clear()
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            shows_too(State.ARMED)
        assert found == []
    finally:
        client.close()
        heard.close()


def test_each_state_has_its_sign_its_colour_and_its_place_among_those_with_torque():
    folder = Path(snapshots.__file__).parent
    script, sheet = ((folder / name).read_text("utf-8") for name in ("page.js", "page.css"))
    for state in [one.value for one in State]:
        assert re.search(rf'^  {state}: "M', script, re.MULTILINE), state
        coloured = (
            f'body[data-state="{state}"] {{' in sheet and f'li[data-state="{state}"]' in sheet
        )
        assert coloured or state == "disarmed"
    with_torque = [one.value for one in State if one not in (State.DISARMED, State.STOP)]
    assert json.loads(script.partition("TORQUE = ")[2].partition(";")[0]) == with_torque


def test_a_wrong_token_is_refused_said_and_moves_nothing(lab, chromium):
    lab.rest()
    visit(chromium, lab.page + "#token=wrong")
    until(lambda: "refused: wrong token" in shown(chromium, "said"))
    lab.order(do="swim")  # of another page: news of it must not overwrite the refusal
    until(lambda: shown(chromium, "sent") == "another page: SWIM refused: not armed yet")
    assert "refused: wrong token" in shown(chromium, "said")
    shows(chromium, State.DISARMED)
    assert not chromium.find_element(By.ID, "arm").is_enabled()
    drag = ActionChains(chromium).move_to_element(
        chromium.find_element(By.CSS_SELECTOR, "#target .touch")
    )
    drag.click_and_hold().move_by_offset(-200, 50).release().perform()
    typed = chromium.find_element(By.ID, "token")
    typed.send_keys("also-wrong", Keys.ENTER)
    time.sleep(0.3)
    assert lab.loop.safety_status.state is State.DISARMED and near(lab, *TAG)
    typed.clear()
    typed.send_keys(lab.client.token, Keys.ENTER)
    until(lambda: "token accepted" in shown(chromium, "said"))
    until(lambda: chromium.find_element(By.ID, "arm").is_enabled())


def test_an_answer_says_what_the_robot_did_to_the_page_that_asked_and_stays(lab, page):
    lab.rest()
    lab.loop.logging = lambda: False
    try:
        button = page.find_element(By.ID, "arm")
        until(button.is_enabled)
        button.click()
        until(lambda: shown(page, "said") == "ARM refused: the log cannot be written")
        assert lab.torque == 0
        lab.order(do="disarm")
        until(lambda: shown(page, "sent") == "another page: DISARM done: disarmed")
        assert shown(page, "said") == "ARM refused: the log cannot be written"
    finally:
        lab.loop.logging = lambda: True
    until(button.is_enabled)
    button.click()
    until(lambda: shown(page, "said") == "ARM done: armed")
    assert "DISARM" in shown(page, "sent")


def test_the_address_with_the_token_pasted_over_the_open_page_is_taken(lab, chromium):
    visit(chromium, lab.page)
    until(lambda: chromium.find_element(By.ID, "key").is_displayed())
    chromium.execute_script("window.here = true")
    chromium.get(lab.client.url)
    until(lambda: shown(chromium, "said") == "token accepted")
    assert chromium.execute_script("return window.here")  # it was not loaded again
    assert not chromium.find_element(By.ID, "key").is_displayed()
    chromium.get(lab.page + "#token=wrong")
    until(lambda: "refused: wrong token" in shown(chromium, "said"))
    assert chromium.get_log("browser") == []


def test_the_camera_s_newest_picture_is_shown_and_nothing_comes_from_elsewhere(lab, page):
    lab.picture = JPEG
    try:
        until(lambda: page.find_element(By.ID, "camera").is_displayed())
    finally:
        lab.picture = b""
    loaded = page.execute_script(
        "return performance.getEntriesByType('resource').map((one) => one.name)"
    )
    assert any("camera.jpg" in name for name in loaded)
    assert all(name.startswith(lab.page) for name in loaded)
    until(lambda: not page.find_element(By.ID, "camera").is_displayed())  # an old one goes


@pytest.mark.thorough
def test_a_server_that_dies_is_started_again_and_the_page_comes_back(lab, page):
    until(lambda: time.monotonic() > lab.client.again)
    process = lab.client.process
    process.kill()
    until(lambda: lab.client.process is not process)
    until(lambda: shown(page, "state").lower() == "run" and "waiting" not in shown(page, "reason"))
    before = lab.loop.devices.receiver.accepted
    until(lambda: lab.loop.devices.receiver.accepted > before)
    page.get_log("browser")  # that it was away is said there, rightly


# ---- without one --------------------------------------------------------------------------------


def test_commands_that_cannot_be_are_refused_with_the_reason(lab):
    token = lab.client.token
    with ws.connect(live(lab)) as page:
        for words, complaint in (
            ({"do": "arm"}, "wrong token"),
            ({"do": "target", "at": [0, 0], "token": token[:-1]}, "wrong token"),
            ({"do": "target", "at": [9, 0], "token": token}, "outside the pool of 5.5 by 2.7 m"),
            ({"do": "target", "at": [1], "token": token}, "two numbers"),
            ({"do": "target", "at": ["1", None], "token": token}, "two numbers"),
            ({"do": "dance", "token": token}, "not a command"),
            ({"token": token}, "not a command"),
        ):
            assert complaint in ask(page, **words), words


@pytest.mark.thorough
def test_a_browser_that_does_not_draw_gets_the_newest_when_it_does(lab):
    """It holds up neither the sender nor itself with old news."""
    lab.order(do="tag")
    with ws.connect(live(lab)) as slow:
        slow.recv(SOON)
        before = lab.loop.devices.receiver.accepted
        lab.order(do="target", at=[-1.0, 0.25])
        until(lambda: near(lab, -1.0, 0.25))
        until(lambda: lab.loop.devices.receiver.accepted > before + 30)
        with pytest.raises(TimeoutError):
            slow.recv(0.3)
        slow.send("drawn")
        assert json.loads(slow.recv(SOON))["now"]["target"] == [-1.0, 0.25]
    lab.order(do="tag")


@pytest.mark.thorough
def test_where_a_console_cannot_be_is_one_sentence_and_an_open_one_is_warned_of(lab, monkeypatch):
    with pytest.raises(BadInput, match="choose another address or port"):
        open_client(lab.client.listening.getsockname(), ROOM)
    with pytest.raises(BadInput, match="give the address of one"):
        open_client(("0.0.0.0", 0), ROOM)
    assert len(announce(lab.client)) == 1 and lab.client.token in announce(lab.client)[0]
    assert not is_local("192.168.4.1") and is_local("127.0.0.1")
    monkeypatch.setattr("tailbeat.operator.client.is_local", lambda host: False)
    assert "open to this network" in announce(lab.client)[1]
