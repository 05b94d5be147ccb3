"""Playing a protocol on a servo: through real bytes it records what the virtual pool records."""

import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from lines import PATIENT, XW430, servo_bench
from support import command, tailbeat_process, until
from synthetic import record
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.runs import as_run
from tailbeat.identify.servo import as_bench
from tailbeat.pool.protocols import record_fluid
from tailbeat.recording import Recording, read_recording, write_recording
from tailbeat.robot import safety, servo, watchdog
from tailbeat.robot.play import PlayConfig, checked, play
from tailbeat.robot.player import GAP, Player, recorded

FISH = load_fish("pulley-fish")


def commands(name: str, seconds: float = 4.0, stroke: float = 0.6) -> Recording:
    time_ = np.arange(0.0, seconds, 0.02)
    sine = stroke * np.sin(2 * np.pi * 1.5 * np.maximum(time_ - 0.5, 0.0))
    label = np.where(time_ < 0.5, "rest", "beat")
    return Recording(name, time_, {"command_rad": sine}, {"purpose": "x"}, {"condition": label})


# ---- through emulated devices -------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.realtime
def test_a_swim_and_a_bench_played_on_devices_are_those_of_the_virtual_pool(tmp_path):
    """Servo bytes, signed poses and two clocks lie between. A pose that is taken where the row is,
    and not where the camera saw it, is 30 ms late: a hundredth of the way here, and 1 cm."""
    for one in (commands("fluid-a", 8.0), commands("servo-a")):
        write_recording(one, tmp_path / f"{one.name}.csv")
    words = ["fluid-a.csv", "servo-a.csv", "--fish", "pulley-fish", "--emulated", "--out", "data"]
    words += ["--json", "done.json"]
    done = tailbeat_process("play", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "done.json").read_text())["recordings"]
    assert [row["recording"] for row in told] == ["data/fluid-a.csv", "data/servo-a.csv"]
    swim, bench = (read_recording(tmp_path / "data" / f"{k}-a.csv") for k in ("fluid", "servo"))
    assert list(bench.columns) == ["command_rad", "angle_rad"]
    assert set(swim.labels["condition"]) == {"rest", "beat"}
    assert swim.meta["servo_model"] == XW430.model
    as_bench(bench, FISH)
    (wanted,) = record_fluid(FISH, commands=[commands("fluid-a", 8.0)])
    ours, theirs = (as_run(one, FISH) for one in (swim, wanted))
    assert ours.gait.frequency == pytest.approx(theirs.gait.frequency, abs=0.01)
    assert ours.gait.speed == pytest.approx(theirs.gait.speed, rel=0.03)
    at = np.arange(0.1, 7.8, 0.02)
    angles = [np.interp(at, r.time, r.columns["motor_angle_rad"]) for r in (swim, wanted)]
    assert np.sqrt(np.mean((angles[0] - angles[1]) ** 2)) < 0.01
    ways = [np.interp(at, r.time, r.columns["x_m"]) for r in (swim, wanted)]
    apart = np.diff([way - way[0] for way in ways], axis=0)[0]
    assert np.abs(apart[at > 6.0]).mean() < 0.05


# ---- what ends it -------------------------------------------------------------------------------


@pytest.fixture
def spared(monkeypatch):
    """A watchdog kills its parent if that stalls for a second. Here the parent would be pytest's
    own process, and the run would never end; so a shell stands between."""
    shell = ["sh", "-c", '"$@"; exit $?', "sh", sys.executable]
    begun = partial(subprocess.Popen, start_new_session=True)
    monkeypatch.setattr(watchdog, "start", lambda words, **more: begun([*shell, *words], **more))


def test_a_test_that_stalls_is_not_killed(spared):
    with servo_bench() as bench, watchdog.guard(bench.path) as watcher:
        watcher.beat(torque=True)
        assert watcher.process.wait(10.0) == -signal.SIGKILL


def player_of(bench, watcher) -> Player:
    driver = servo.connect(bench.path, XW430, deadline=PATIENT)
    # A machine that stalls for 0.1 s trips the servo's own watchdog. Its rule is off here, and a
    # servo that stopped with its command is one that follows it: then nothing ended the play.
    driver.arm = partial(driver.arm, 2.5)  # type: ignore[method-assign]
    limits = replace(safety.limits_for(XW430), servo_stop=5.0, own_watchdog=False)
    return Player(driver, watcher, limits)


@pytest.mark.realtime
def test_a_stop_and_a_jammed_tail_turn_torque_off_at_once(spared):
    with servo_bench() as bench, watchdog.guard(bench.path) as watcher:
        player = player_of(bench, watcher)
        threading.Timer(1.0, lambda: setattr(player, "stop_asked", "the operator")).start()
        with pytest.raises(BadInput, match="stopped, torque is off: stop asked by the operator"):
            player.play(commands("servo-a", 20.0), 0.0, swim=False)
        assert not bench.on
        player.stop_asked = ""
        threading.Timer(1.0, lambda: setattr(bench.device.faults, "frozen", True)).start()
        began = time.monotonic()
        with pytest.raises(BadInput, match="the shaft does not follow"):
            player.play(commands("servo-a", 20.0), 0.0, swim=False)
        assert not bench.on and time.monotonic() - began < 4.0
        watcher.farewell()
        player.servo.close()


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("register", "value", "said"), [(146, 76, "servo at 76 deg C"), (144, 97, "supply 9.7 V")]
)
def test_a_hot_servo_and_a_low_supply_end_it(spared, register, value, said):
    with servo_bench() as bench, watchdog.guard(bench.path) as watcher:
        player = player_of(bench, watcher)

        def spoil() -> None:
            bench.device.faults.frozen = True
            bench.device.put(register, value)

        threading.Timer(0.6, spoil).start()
        with pytest.raises(BadInput, match=said):
            player.play(commands("servo-a", 20.0), 0.0, swim=False)
        assert not bench.on
        watcher.farewell()
        player.servo.close()


@pytest.mark.realtime
def test_a_servo_that_is_silent_from_the_start_is_lost_and_torque_is_said_to_be_on(
    spared, monkeypatch
):
    """Nothing had been read since arming, so nothing was late: it played to a dead servo."""
    with servo_bench() as bench, watchdog.guard(bench.path) as watcher:
        player = player_of(bench, watcher)
        player.limits = replace(player.limits, servo_stop=0.5)
        arm = player._arm

        def mute(low: float, high: float) -> None:
            arm(low, high)
            bench.device.faults.mute = 10**6

        monkeypatch.setattr(player, "_arm", mute)
        began = time.monotonic()
        with pytest.raises(BadInput, match="TORQUE MAY BE ON") as told:
            player.play(commands("servo-a", 60.0), 0.0, swim=False)
        assert "no servo for 0." in str(told.value.__context__)
        assert time.monotonic() - began < 10.0
        bench.device.faults.mute = 0
        player.servo.close()
        assert not bench.on
        watcher.farewell()


@pytest.mark.thorough
@pytest.mark.realtime
def test_what_was_played_before_ctrl_c_stays_and_nothing_is_half_written(tmp_path):
    for name, seconds in (("servo-a", 1.0), ("servo-b", 60.0)):
        write_recording(commands(name, seconds), tmp_path / f"{name}.csv")
    words = ["servo-a.csv", "servo-b.csv", "--fish", "pulley-fish", "--emulated", "--out", "data"]
    process = subprocess.Popen(
        command("play", *words), cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    until(lambda: (tmp_path / "data" / "servo-a.csv").is_file(), seconds=60.0)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 2 and "stop asked by the operator" in said, said
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["servo-a.csv"]


def test_commands_that_this_fish_may_not_play_are_refused(tmp_path):
    config = PlayConfig("pulley-fish", "/dev/none", tmp_path)
    for one, fish, said in (
        (commands("servo-a", stroke=1.5), FISH, "command_rad reaches -1.500 to 1.500 rad"),
        (commands("servo-a"), load_fish("crank-fish"), "its motor turns without end"),
        (commands("fluid-a"), FISH, "a swim needs the camera's poses"),
        (record(FISH, "servo-a", 1.5, 0.5, seconds=1.0), FISH, "command_rad is missing"),
    ):
        with pytest.raises(BadInput, match=said):
            checked(one, fish, config)
    write_recording(commands("servo-a"), tmp_path / "servo-a.csv")
    with pytest.raises(BadInput, match=r"servo-a\.csv.*exists"):
        play(config, [tmp_path / "servo-a.csv"], print)


# ---- poses and rows -----------------------------------------------------------------------------


def test_a_row_has_the_pose_of_its_own_time_and_none_where_the_camera_was_blind():
    """Poses come sixty times a second on the camera's clock, with yaw across half a turn."""
    began, at = 1000.0, np.arange(0.0, 4.0, 0.02)
    seen = [(began + t, 0.3 * t, -0.1 * t, (3.0 + t + np.pi) % (2 * np.pi) - np.pi)
            for t in np.arange(-0.1, 4.2, 1 / 60) if not 1.0 < t < 1.5]  # fmt: skip
    rows = np.column_stack([at, np.zeros_like(at), np.zeros_like(at)])
    found = recorded(commands("fluid-a"), rows, seen, began)
    blind = (at > 1.0 + GAP / 6) & (at < 1.5 - GAP / 6)
    assert found.time.size == pytest.approx((~blind).sum(), abs=2)
    assert found.columns["x_m"] == pytest.approx(0.3 * found.time, abs=1e-9)
    assert np.unwrap(found.columns["yaw_rad"]) == pytest.approx(3.0 + found.time, abs=1e-9)
    assert list(found.labels["condition"][:30]) == ["rest"] * 25 + ["beat"] * 5
    bench = recorded(commands("servo-a"), rows, None, began)
    assert bench.time.size == at.size and list(bench.columns) == ["command_rad", "angle_rad"]
