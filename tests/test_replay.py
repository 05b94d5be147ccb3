"""The replay of a finished run: each moment as the log has it, on the page in a real browser."""

import json
import math
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the robot extra is not installed")
pytest.importorskip("fastapi", reason="the station extra is not installed")
pytest.importorskip("websockets", reason="the station extra is not installed")
pytest.importorskip("selenium", reason="the dev extra is not installed")

import numpy as np
import websockets.sync.client as ws
from mcap.writer import Writer
from selenium import webdriver
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from browser import shown, visit
from support import command, complaint, until
from tailbeat.fish.store import load_fish
from tailbeat.operator.replay import Run, read_run, snapshot
from tailbeat.robot.log import start

pytestmark = pytest.mark.realtime

FISH, POOL, TARGET = load_fish("pulley-fish"), (5.5, 2.7), (1.0, 0.5)
ROWS, SWIMS = 401, slice(100, 350)  # of eight seconds it swims from 2 to 7


def row(k: int) -> dict[str, Any]:
    """A row as the loop writes it: the fish goes ahead at 0.2 m/s from x = -1 m."""
    swims = k in range(*SWIMS.indices(ROWS))
    state, reason = ("run", "swimming") if swims else ("armed", "armed")
    if k < 50:
        state, reason = "disarmed", "not armed yet"
    if k >= SWIMS.stop:
        state, reason = "stop", "stop asked by the operator page"
    x, y, yaw = -1 + 0.004 * k, 0.3, 0.1
    seen: Any = np.tile([x, y, yaw, *TARGET, 0.02], (3, 1)) if swims else []
    return {
        "time_s": 500 + 0.02 * k, "state": state, "reason": reason, "cause": "swimming",
        "command_rad": 0.2, "motor_angle_rad": 0.5 * math.sin(0.2 * k), "yaw_rate_rad_s": 0.0,
        "x_m": x, "y_m": y, "yaw_rad": yaw, "pose_age_s": 0.02, "clock_doubt_s": 0.002,
        "temperature_deg_c": 31.0, "voltage_v": 11.9, "current_a": 0.4, "band_share": 0.9,
        "late_s": 0.001, "busy_s": 0.007 if k == 200 else 0.004, "missed": 0,
        "observation": np.zeros(24) if swims else [], "action": [], "decided_on": seen,
    }  # fmt: skip


def write_log(path: Path, rows: list[dict[str, Any]]) -> Path:
    log = start(path, {"policy": "p", "fish": FISH.model_dump_json()})
    for one in rows:
        until(lambda: log.waiting.qsize() < 400)
        log.put(one)
    log.close()
    assert not log.dropped and not log.failed
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("replay") / "pool.mcap", [*map(row, range(ROWS))])


@pytest.fixture(scope="module")
def run(log: Path) -> Run:
    return read_run(log)


def serve(log: Path) -> tuple["subprocess.Popen[str]", list[str]]:
    """The verb, and what it said up to its address."""
    words = command("station", "--replay", log, "--page", "127.0.0.1:0")
    process, said = subprocess.Popen(words, stdout=subprocess.PIPE, text=True), list[str]()
    assert process.stdout is not None
    while "http" not in "".join(said):
        said.append(process.stdout.readline())
        assert said[-1], "it ended"
    return process, said


@pytest.fixture(scope="module")
def url(log: Path) -> Iterator[str]:
    process, said = serve(log)
    try:
        yield said[-1].split()[-1]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait(10)
        process.stdout.close()  # type: ignore[union-attr]


@pytest.fixture
def page(url: str, chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """The page at the run's begin, standing still; in the end the browser has nothing to say."""
    visit(chromium, url)
    until(lambda: shown(chromium, "clock") == "0.0 of 8.0 s")
    yield chromium
    assert chromium.get_log("browser") == []


def slide(browser: webdriver.Chrome, seconds: float) -> None:
    browser.execute_script(
        "const slider = document.getElementById('time'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'))",
        seconds,
    )


def clock(browser: webdriver.Chrome) -> float:
    return float(shown(browser, "clock").split()[0])


def nose(browser: webdriver.Chrome) -> float:
    """x of the fish's foremost point on the map [m]."""
    return browser.execute_script(
        "const box = document.getElementById('fish').getBBox(); return box.x + box.width"
    )


# ---- a moment -----------------------------------------------------------------------------------


def test_a_moment_is_the_log_s_row_at_that_time(run):
    seen = snapshot(run, FISH, POOL, 4.0)
    assert run.seconds == pytest.approx(8.0) and run.whole
    assert seen["fish"]["pose"] == pytest.approx([-0.2, 0.3, 0.1])
    assert seen["target"] == pytest.approx(TARGET)
    status = seen["status"]
    assert (status["state"], status["reason"]) == ("run", "swimming")
    assert status["voltage"] == 11.9 and status["angle"] == pytest.approx(0.5 * math.sin(40))
    assert snapshot(run, FISH, POOL, 4.06)["status"]["busy"] == 0.007  # the longest of 0.1 s
    assert snapshot(run, FISH, POOL, 4.16)["status"]["busy"] == 0.004
    assert snapshot(run, FISH, POOL, 1.5)["target"] is None  # known while it swims
    assert snapshot(run, FISH, POOL, -9.0)["fish"]["pose"][0] == pytest.approx(-1.0)
    assert snapshot(run, FISH, POOL, 99.0)["fish"]["pose"][0] == pytest.approx(0.6)


def test_the_path_behind_a_moment_is_what_was_swum_before_it(run):
    age, x, y = np.array(snapshot(run, FISH, POOL, 4.0)["trail"]).T
    assert (np.diff(age) < 0).all() and age[0] == pytest.approx(4.0) and age[-1] == 0.0
    assert x == pytest.approx(-0.2 - 0.2 * age, abs=1e-3) and (y == 0.3).all()


def test_a_moving_target_is_shown_where_it_was_with_its_velocity_and_distances(tmp_path):
    rows = [row(k) for k in range(ROWS)]
    for k in range(*SWIMS.indices(ROWS)):
        rows[k]["decided_on"][:, 3] = 1.0 - 0.15 * 0.02 * k
    run = read_run(write_log(tmp_path / "moves.mcap", rows))
    seen = snapshot(run, FISH, POOL, 4.0)
    assert seen["target"] == pytest.approx([1.0 - 0.15 * 4.0, 0.5])
    assert seen["velocity"] == pytest.approx((-0.15, 0.0), abs=1e-6)
    ages, away = zip(*seen["distances"], strict=True)
    assert list(ages) == sorted(ages, reverse=True) and ages[-1] == 0 and ages[0] > 1.5
    assert away[-1] == pytest.approx(math.hypot(1.0 - 0.6 - (-1 + 0.8), 0.2), abs=1e-3)
    before, after = (snapshot(run, FISH, POOL, at) for at in (1.0, 7.5))
    assert before["velocity"] is None and before["distances"] == []
    assert after["velocity"] is None and len(after["distances"]) > 20


def test_changes_are_the_states_with_the_times_at_which_they_began(run):
    found = [(round(one.at, 2), one.state) for one in run.changes()]
    assert found == [(0.0, "disarmed"), (1.0, "armed"), (2.0, "run"), (7.0, "stop")]


def test_a_row_without_a_pose_shows_no_fish(tmp_path):
    lost = {**row(2), **dict.fromkeys(("x_m", "y_m", "yaw_rad"), math.nan)}
    found = read_run(write_log(tmp_path / "a.mcap", [row(0), row(1), lost]))
    seen = snapshot(found, FISH, POOL, 0.05)
    assert seen["fish"] is None and len(seen["trail"]) == 1


# ---- in the browser -----------------------------------------------------------------------------


def test_the_page_plays_pauses_and_stops_at_the_end(page):
    assert "replay of pool.mcap" in shown(page, "replayed")
    assert shown(page, "state").lower() == "disarmed"
    at_first = nose(page)
    page.find_element(By.ID, "play").click()
    until(lambda: clock(page) > 0.3 and nose(page) > at_first + 0.03)
    page.find_element(By.ID, "play").click()
    until(lambda: shown(page, "play") == "Play")
    page.execute_async_script("setTimeout(arguments[0], 200)")  # a row may be on its way
    stands = clock(page)
    assert 0.3 < stands < 8.0
    page.execute_async_script("setTimeout(arguments[0], 700)")
    assert clock(page) == stands
    assert "no connection" not in shown(page, "reason")
    slide(page, 7.9)
    ActionChains(page).send_keys(" ").perform()  # the space bar plays: there is nothing to stop
    until(lambda: clock(page) == 8.0 and shown(page, "play") == "Play")
    ActionChains(page).send_keys(" ").perform()  # and at the end from the begin
    until(lambda: 0 < clock(page) < 7.0)


def test_the_slider_shows_the_moment_it_is_put_to(page):
    slide(page, 4.0)
    until(lambda: shown(page, "state").lower() == "run")
    until(lambda: nose(page) == pytest.approx(snapshot_nose(4.0), abs=0.02))
    assert "target at x 1.00, y 0.50" in shown(page, "where")
    assert "11.9 V" in shown(page, "gauges") and "31 °C" in shown(page, "gauges")
    assert page.find_element(By.CSS_SELECTOR, "#trail polyline")
    slide(page, 1.5)
    until(lambda: shown(page, "state").lower() == "armed")
    assert "no target" in shown(page, "where")
    assert not page.find_element(By.ID, "target").is_displayed()


def snapshot_nose(seconds: float) -> float:
    from tailbeat.operator.snapshot import body

    k = round(seconds / 0.02)
    x, y, yaw = (row(k)[name] for name in ("x_m", "y_m", "yaw_rad"))
    return max(place[0] for place in body(FISH, (x, y, yaw), row(k)["motor_angle_rad"]))


def test_speed_is_how_fast_the_time_of_the_run_passes(page):
    Select(page.find_element(By.ID, "speed")).select_by_value("8")
    took = page.execute_async_script(
        "const done = arguments[0], from = performance.now();"
        "document.getElementById('play').click();"
        "const look = () => { if (document.getElementById('play').textContent === 'Play')"
        " done(performance.now() - from); else setTimeout(look, 5); }; look()"
    )
    assert 950 < took < 4000 and clock(page) == 8.0  # ms; eight seconds at eight times


def test_state_changes_are_listed_and_a_click_goes_there(page):
    rows = page.find_elements(By.CSS_SELECTOR, "#changes li")
    assert [one.text.split("\n")[:2] for one in rows] == [
        ["0.0 s", "DISARMED"], ["1.0 s", "ARMED"], ["2.0 s", "RUN"], ["7.0 s", "STOP"]
    ]  # fmt: skip
    assert rows[0].get_attribute("aria-current") == "true"
    rows[3].find_element(By.TAG_NAME, "button").click()
    until(lambda: shown(page, "state").lower() == "stop")
    assert clock(page) == 7.0
    until(lambda: rows[3].get_attribute("aria-current") == "true")


def test_no_order_can_be_given_and_the_page_says_so(page, url):
    for name in ("arm", "swim", "disarm", "tag", "stop"):
        assert not page.find_element(By.ID, name).is_enabled(), name
    assert not page.find_element(By.ID, "key").is_displayed()
    assert "takes no orders" in shown(page, "said")
    assert "no fish is connected" in shown(page, "stop")
    until(lambda: shown(page, "dark") == "The log holds no camera pictures.")  # looked at twice a s
    with ws.connect(f"{url.replace('http', 'ws')}live") as other:
        assert json.loads(other.recv(30))["replay"]["name"] == "pool.mcap"
        for words, answer in (
            ({"do": "arm"}, "this is the replay of a log"),
            ({"do": "stop"}, "this is the replay of a log"),
            ({"do": "at", "at": "soon"}, "a time is a number"),
            ([1], "not a command"),
            ({"do": "at", "at": math.inf}, "not a command"),
        ):
            other.send(json.dumps(words))
            assert answer in json.loads(other.recv(30))["said"][0]
        for odd in ("[" * 1990, b'{"do": "at", "at": 1}', '{"do": "at", "at": 1e999}'):
            other.send(odd)
            assert json.loads(other.recv(30))["said"] == ["refused: not a command"]


def test_the_page_fits_a_phone(page):
    for width, height in ((390, 844), (1280, 800)):
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
        rows = page.execute_script(
            "return [...document.querySelectorAll('.gauge')].map((one) => one.offsetLeft)"
        )
        assert len(rows) % len(set(rows)) == 0  # no orphan in the grid of readings
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


# ---- bad input ----------------------------------------------------------------------------------


def test_a_half_written_log_is_replayed_up_to_its_end_and_said(log, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    process, said = serve(cut)
    try:
        assert "cut.mcap: cut off; the replay ends where the log ends" in said[0]
        with ws.connect(f"{said[-1].split()[-1].replace('http', 'ws')}live") as page:
            about = json.loads(page.recv(30))["replay"]
        assert not about["whole"] and 1.0 < about["seconds"] < 7.0
    finally:
        process.kill()
        process.wait(10)
        process.stdout.close()  # type: ignore[union-attr]


def test_what_cannot_be_replayed_is_one_sentence(tmp_path, log):
    for name, text in (("empty", b""), ("text", b"hello")):
        (tmp_path / f"{name}.mcap").write_bytes(text)
    other(tmp_path / "other.mcap", "/imu", {"time_s": 1.0})
    other(tmp_path / "fields.mcap", "/swim", {"time_s": 1.0, "x": 2.0})
    other(tmp_path / "list.mcap", "/swim", [1, 2])
    write_log(tmp_path / "state.mcap", [{**row(0), "state": "asleep"}])
    write_log(tmp_path / "back.mcap", [row(5), row(3)])
    write_log(tmp_path / "word.mcap", [{**row(0), "x_m": "left"}])
    for name, words in (
        ("none", "no such file"),
        ("empty", "no row of a swim"),
        ("text", "no row of a swim"),
        ("other", "no row of a swim"),
        ("fields", "no row has state"),
        ("list", "is not a JSON object"),
        ("state", "row 0: state is 'asleep', not one of disarmed"),
        ("back", "row 1: time_s goes back"),
        ("word", "row 0: x_m is 'left', not a number"),
    ):
        # a page that cannot be: a log that is taken ends with another sentence, not with a server
        said = complaint("station", "--replay", tmp_path / f"{name}.mcap", "--page", "8080")
        assert words in said and f"{name}.mcap" in said, said


def other(path: Path, topic: str, message: Any) -> None:
    """A log of somebody else's."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("Other", "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", kind)
        writer.add_message(channel, 1, json.dumps(message).encode(), 1)
        writer.finish()


@pytest.mark.thorough
def test_options_that_a_replay_cannot_have_are_refused(log):
    assert "--camera: a replay has no fish" in complaint(
        "station", "--replay", log, "--camera", "/dev/video0", "--page", "8080"
    )
    assert "give length,width" in complaint("station", "--replay", log, "--pool", "9")
    assert "give host:port" in complaint("station", "--replay", log, "--page", "8080")
    assert "or a log to --replay" in complaint("station", "--page", "127.0.0.1:0")
