"""The operator's page in a real browser, with the emulated bench and the robot's loop behind it.

Rig and loop are threads here and share an interpreter with the test, so limits are wide. What the
page asks for is looked up where it ends: in the frames that the fish got and in its servo.
"""

import contextlib
import json
import math
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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
from websockets.exceptions import InvalidMessage

from browser import shown, visit
from lines import XW430
from support import command, until
from tailbeat.cli import station, swim
from tailbeat.control.policy import load_policy
from tailbeat.emulators import rig as bench
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import Numbers, State, Status
from tailbeat.operator.client import (
    OperatorClient,
    announce,
    is_local,
    open_client,
    open_page,
    turn,
)
from tailbeat.operator.snapshot import body, snapshot
from tailbeat.robot.devices import Devices
from tailbeat.robot.dynamixel_tables import X
from tailbeat.robot.imu import connect as connect_imu
from tailbeat.robot.loop import Loop
from tailbeat.robot.safety import SafetyLimits
from tailbeat.robot.servo import connect as connect_servo

pytestmark = pytest.mark.realtime

KEY, ROOM, TAG = bytes(32), (5.5, 2.7), (1.5, 0.5)
FISH, POLICY = load_fish("pulley-fish"), load_policy("pulley-fish-pool-generator")
WIDE = SafetyLimits(pose_hold=9.0, pose_stop=15.0, imu_hold=9.0, servo_hold=9.0, servo_stop=15.0,
              clock_doubt=2.0, overruns_hold=10**6)  # fmt: skip
PATIENT = 4.0  # s for a reply of servo or IMU: their thread waits for a processor
SOON = 40.0  # s: what takes a tenth of a second may take that on a busy machine
# A picture to be found again: one grey pixel.
JPEG = bytes.fromhex(
    "ffd8ffe000104a46494600010100000100010000ffdb004300" + "08" * 64 + "ffc0000b080001000101011100"
    "ffc4001f0000010501010101010100000000000000000102030405060708090a0b"
    "ffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1"
    "c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a6364"
    "65666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9"
    "bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
    "ffda0008010100003f00fbd0ffd9"
)


@dataclass
class Lab:
    """A loop that ticks, the rig under it, and the rig's operator page."""

    loop: Loop
    rig: bench.Rig
    client: OperatorClient
    picture: bytes = b""

    @property
    def torque(self) -> int:
        return self.rig.servo.get(64)

    @property
    def target(self) -> tuple[float, float] | None:
        """The one that the fish got."""
        frames = self.loop.devices.receiver.frames
        return frames[0].target if frames else None

    @property
    def page(self) -> str:
        return self.client.url.partition("#")[0]

    def order(self, **words: Any) -> None:
        """As a page with the token does; the server answers in turn, so it has taken it."""
        with ws.connect(live(self)) as page:
            page.send(json.dumps({"token": self.client.token, **words}))
            assert ask(page, do="hello", token=self.client.token) == "token accepted"

    def bring(self, word: str, state: State, give: Callable[[], None] | None = None) -> None:
        """Order until it is so, as an operator does: a busy machine may lose or refuse an order."""
        for _ in range(5):
            give() if give else self.order(do=word)
            with contextlib.suppress(AssertionError):
                self.stands(state, SOON / 5)
                return
        self.stands(state, 0.0)

    def rest(self) -> None:
        """Back to a disarmed fish that follows its tag."""
        self.bring("disarm", State.DISARMED)
        self.order(do="tag")
        until(lambda: near(self, *TAG))

    def swim(self) -> None:
        self.rest()
        for word, state in (("arm", State.ARMED), ("swim", State.RUN)):
            self.bring(word, state)

    def stands(self, state: State, seconds: float = SOON) -> None:
        now = lambda: self.loop.safety_status  # noqa: E731
        until(lambda: now().state is state, what=now, seconds=seconds)


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    heard = link.bind("127.0.0.1", 0)
    rig = bench.open_rig(FISH, KEY, heard.getsockname(), TAG)
    rig.shaft.advance(0.0, 0.01)
    client, ended = open_client(("127.0.0.1", 0), ROOM), threading.Event()
    made = Lab(None, rig, client)  # type: ignore[arg-type]

    def over() -> bool:
        turn(client, rig.station.sender, FISH, time.monotonic(), picture=made.picture)
        return ended.is_set()

    def tick() -> None:
        while not ended.is_set():
            made.loop.tick(time.monotonic())
            time.sleep(0.02)

    serving = threading.Thread(target=bench.serve, args=(rig, over), daemon=True)
    serving.start()
    servo, imu = (
        connect_servo(rig.ports[0], XW430, deadline=PATIENT),
        connect_imu(rig.ports[1], None, PATIENT),
    )
    imu.prepare()
    arming = servo.arm

    def armed(watchdog: float = 0.1) -> float:
        """Without the servo's own watchdog: a thread may be late by more than it can wait."""
        held = arming()
        servo.set(X.bus_watchdog, 0)
        return held

    servo.arm = armed  # type: ignore[method-assign]
    receiver = link.Receiver(KEY, ROOM)
    devices = Devices(servo, imu, receiver, heard, rig.station.socket.getsockname())
    made.loop = Loop(POLICY, devices, lambda row: None, WIDE, sign_test=False)
    ticking = threading.Thread(target=tick, daemon=True)
    ticking.start()
    until(lambda: receiver.clock.offset(0) is not None and made.loop.poses.seen)
    yield made
    ended.set()
    for thread in (ticking, serving):
        thread.join(10)
    servo.close()
    imu.close()
    client.close()
    bench.close_rig(rig)
    heard.close()


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


def near(lab: Lab, x: float, y: float) -> bool:
    at = lab.target
    return at is not None and abs(at[0] - x) < 0.03 and abs(at[1] - y) < 0.03


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

    leading = threading.Thread(target=lead, daemon=True)
    leading.start()
    try:
        until(lambda: re.search(r"moves at 0\.(09|10|11) m/s", shown(page, "where")),
              what=lambda: shown(page, "where"))  # fmt: skip
        arrow = page.find_element(By.ID, "motion").get_attribute("d")
        x, y = map(float, re.findall(r"^M0 0L(\S+) ([^L]+)L", arrow)[0])
        assert x == pytest.approx(-0.2, abs=0.05) and y == pytest.approx(0.0, abs=0.05)
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
        visit(chromium, client.url.partition("#")[0])
        until(lambda: shows_too(State.RUN))
        chromium.find_element(By.ID, "stop").click()
        until(lambda: shows_too(State.RUN) and found.count("stop") > 1)  # it is repeated
        until(lambda: shows_too(State.STOP))
        found.clear()
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            shows_too(State.ARMED)
        assert found == []
    finally:
        client.close()
        heard.close()


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


def live(lab: Lab) -> str:
    return f"{lab.page.replace('http', 'ws')}live"


def ask(page: ws.ClientConnection, **words: Any) -> str:
    """What the server says to a command."""
    page.send(json.dumps(words))
    end = time.monotonic() + SOON
    while time.monotonic() < end:
        message = json.loads(page.recv(SOON))
        page.send("drawn")
        if message["said"]:
            return message["said"][0]
    raise AssertionError("no answer")


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


def test_where_a_console_cannot_be_is_one_sentence_and_an_open_one_is_warned_of(lab, monkeypatch):
    with pytest.raises(BadInput, match="choose another address or port"):
        open_client(lab.client.listening.getsockname(), ROOM)
    with pytest.raises(BadInput, match="give the address of one"):
        open_client(("0.0.0.0", 0), ROOM)
    assert len(announce(lab.client)) == 1 and lab.client.token in announce(lab.client)[0]
    assert not is_local("192.168.4.1") and is_local("127.0.0.1")
    monkeypatch.setattr("tailbeat.operator.client.is_local", lambda host: False)
    assert "open to this network" in announce(lab.client)[1]


def test_the_fish_is_drawn_where_its_tag_is_and_bends_to_the_motor_s_side():
    straight, left = body(FISH, (1.0, 0.5, 0.0), 0.0), body(FISH, (1.0, 0.5, 0.0), 0.5)
    nose, fin = straight[0], straight[-1]
    tag = FISH.tracked[0]
    assert nose[0] == pytest.approx(1.0 - tag + 0.12) and nose[1] == pytest.approx(0.5)
    assert fin[0] < nose[0] - 0.4 and left[-1][1] > fin[1] + 0.02


# ---- the station's verb --------------------------------------------------------------------------


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
        swim.drive("p", tmp_path / "a", page="127.0.0.1:0", **words)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="--camera needs --calibration"):
        station.station("127.0.0.1:1", tmp_path, "127.0.0.1:2", camera="/dev/video0")
    with pytest.raises(BadInput, match="give host:port"):
        open_page("8080")
