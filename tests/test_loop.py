"""The robot's loop against the emulated bench: real bytes, real datagrams, and faults.

The rig is a thread of this process here and shares its interpreter, so deadlines are wide and
nothing is said of the rate; `drive --emulated`, below, runs it beside.
"""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from support import tailbeat, tailbeat_process
from tailbeat.control import runner as runner
from tailbeat.control.actions import PERIOD
from tailbeat.control.corrections import Corrections
from tailbeat.control.policy import load_policy
from tailbeat.emulators import rig as bench
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Receiver
from tailbeat.link.reasons import Reason
from tailbeat.link.status import State
from tailbeat.recording import read_recording
from tailbeat.robot import session
from tailbeat.robot.checks import CHECKS
from tailbeat.robot.devices import Devices
from tailbeat.robot.imu import connect as connect_imu
from tailbeat.robot.loop import Loop
from tailbeat.robot.plausible import Bounds
from tailbeat.robot.poses import Poses
from tailbeat.robot.safety import SafetyLimits
from tailbeat.robot.servo import connect as connect_servo

pytestmark = pytest.mark.realtime("robot")

KEY, POLICY = bytes(32), load_policy("pulley-fish-pool-generator")
WIDE = SafetyLimits(pose_hold=6.0, pose_stop=9.0, imu_hold=6.0, servo_hold=6.0, servo_stop=9.0,
              clock_doubt=1.0, overruns_hold=10**6)  # fmt: skip
PATIENT = 0.5


@dataclass
class Bench:
    """A loop and the rig it drives; `cut` ends what the rig does."""

    loop: Loop
    rig: bench.Rig
    cut: Callable[[], None]
    rows: list[dict[str, Any]] = field(default_factory=list)

    def ticks(self, until: Callable[[], bool], seconds: float = 60.0) -> None:
        due = time.monotonic()
        end = due + seconds
        while not until():
            assert due < end, self.loop.safety_status
            self.loop.tick(due)
            due = max(due + PERIOD, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))

    def swim(self) -> None:
        """Up to a swimming fish."""
        self.ticks(lambda: self.loop.devices.receiver.clock.offset(0) is not None)
        self.ticks(lambda: bool(self.loop.poses.seen) and self.loop.sensors.servo is not None)
        assert self.loop.arm(time.monotonic()).state is State.ARMED, self.loop.safety_status
        if self.loop.devices.servo.own_watchdog:
            self.loop.devices.servo.set((98, 1), 127)  # a thread may be late
        assert self.loop.swim().state is State.RUN

    @property
    def torque(self) -> int:
        return int(self.rig.servo.on)


@contextmanager
def driven(fish: Fish) -> Iterator[Bench]:
    """A loop that drives the rig of a fish with its servo."""
    heard = link.bind("127.0.0.1", 0)
    made = bench.open_rig(fish, KEY, heard.getsockname(), (1.5, 0.5))
    made.shaft.advance(0.0, 0.01)
    assert made.shaft.pose.shape == (3,)  # compiled before anyone waits for it
    ended = threading.Event()
    thread = threading.Thread(target=bench.serve, args=(made, ended.is_set), daemon=True)
    thread.start()
    servo, imu = (
        connect_servo(made.ports[0], hardware_of(fish), deadline=PATIENT),
        connect_imu(made.ports[1], None, PATIENT),
    )
    imu.prepare()
    devices = Devices(
        servo, imu, link.Receiver(KEY, (5.5, 2.7)), heard, made.station.socket.getsockname()
    )
    rows: list[dict[str, Any]] = []

    def cut() -> None:
        if not ended.is_set():
            ended.set()
            thread.join(5)

    yield Bench(Loop(POLICY, devices, rows.append, WIDE, sign_test=False), made, cut, rows)
    servo.close()
    imu.close()
    cut()
    bench.close_rig(made)
    heard.close()


@pytest.fixture
def swimming() -> Iterator[Bench]:
    with driven(load_fish("pulley-fish")) as made:
        yield made


def test_it_arms_swims_nearer_and_lets_go(swimming):
    swimming.loop.signals.expected = None  # a busy machine's stalls look like a camera that turns
    swimming.swim()
    first = math.hypot(1.5 - swimming.rig.shaft.pose[0], 0.5 - swimming.rig.shaft.pose[1])
    swimming.ticks(lambda: len([r for r in swimming.rows if r["state"] == "run"]) > 250)
    last = math.hypot(1.5 - swimming.rig.shaft.pose[0], 0.5 - swimming.rig.shaft.pose[1])
    assert last < first - 0.1 and swimming.torque == 1
    assert swimming.loop.disarm().state is State.DISARMED and swimming.torque == 0


def test_a_set_target_is_held_against_the_pool_that_the_station_tells(swimming):
    """Not against the virtual pool: 4 m is in a pool of 10 m, and 1.5 m is beyond one of 2 m."""
    station, poses, receiver = swimming.rig.station.sender, swimming.loop.poses, Receiver(KEY)
    assert not Poses(receiver, Bounds(), (4.0, 0.5)).outside()  # nobody has told the size yet
    poses.target, station.pool = (4.0, 0.5), (10.0, 4.0)
    swimming.ticks(lambda: swimming.loop.devices.receiver.room == (10.0, 4.0))
    swimming.swim()
    swimming.loop.disarm()
    poses.target, station.pool = (1.5, 0.5), (2.0, 1.0)
    swimming.ticks(lambda: swimming.loop.devices.receiver.room == (2.0, 1.0))
    refused = swimming.loop.arm(time.monotonic())
    assert refused.state is State.DISARMED and refused.reason is Reason.TARGET_OUTSIDE
    assert refused.text == "the target is outside the pool: allowed x -1 to 1 m, y -0.5 to 0.5 m"


def test_a_drive_by_itself_ends_with_what_is_wrong_with_its_target(swimming):
    loop, station = swimming.loop, swimming.rig.station
    loop.poses.target, station.tag, station.sender.pool = (1.5, 0.5), (0.5, 0.2), (2.0, 1.0)
    swimming.ticks(lambda: loop.devices.receiver.room == (2.0, 1.0))
    swimming.ticks(lambda: bool(loop.poses.seen) and loop.sensors.servo is not None)
    with pytest.raises(BadInput, match=r"--target: the target is outside .* to 1 m, .* to 0\.5 m"):
        session._begin(loop, since=2.0)


def test_poses_are_the_plant_s_and_their_age_is_right_on_another_s_clock(swimming):
    swimming.swim()
    swimming.ticks(lambda: len(swimming.rows) > 60)
    row = swimming.rows[-1]
    assert row["x_m"] == pytest.approx(swimming.rig.shaft.pose[0], abs=0.1)
    assert 0.02 < np.median([r["pose_age_s"] for r in swimming.rows[-20:]]) < 0.3
    ahead = swimming.rig.station.clock() - time.monotonic_ns()
    offset, doubt = swimming.loop.devices.receiver.clock.offset(time.monotonic_ns()) or (0, 0)
    assert abs(offset - ahead) < doubt < 0.006 * link.SECOND  # it was half of the loop's period


def test_what_was_logged_gives_the_same_decisions_again(swimming):
    """Replay equals record: the rows of a swim through the policy runner."""
    swimming.swim()
    swimming.ticks(lambda: len([r for r in swimming.rows if r["state"] == "run"]) > 40)
    course = runner.begin(POLICY)
    ran = [row for row in swimming.rows if row["state"] == "run"]
    for row in ran:
        readings = runner.Readings(
            row["motor_angle_rad"], row["motor_velocity_rad_s"], row["yaw_rate_rad_s"],
            row["decided_on"],
        )  # fmt: skip
        course, decision = runner.steer(POLICY, course, readings)
        assert np.array_equal(decision.action, row["action"])
        assert decision.setpoint == row["setpoint_rad"]


def test_an_order_to_stop_takes_the_torque_at_once(swimming):
    swimming.swim()
    receiver = swimming.loop.devices.receiver
    order = link.stop_datagram(KEY, 1, receiver.nonce, 1)
    swimming.rig.station.socket.sendto(order, swimming.rig.station.fish)
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 2.0)
    assert swimming.torque == 0 and "operator page" in swimming.loop.safety_status.text


def test_a_cut_link_holds_and_then_stops(swimming):
    swimming.swim()
    swimming.rig.station.due = math.inf  # no more frames
    swimming.loop.limits = SafetyLimits(**{**vars(WIDE), "pose_hold": 0.5, "pose_stop": 1.5})
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.HOLD, 5.0)
    assert "no pose for" in swimming.loop.safety_status.text and swimming.torque == 1
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 5.0)
    assert swimming.torque == 0


def test_a_refined_policy_holds_its_own_robot_straight(swimming):
    """Not at the servo's middle, from which its horn is off."""
    known = replace(POLICY.contract, corrections=Corrections(shaft=0.15, setpoint=0.15))
    swimming.loop.policy = replace(POLICY, contract=known)
    swimming.swim()
    swimming.rig.station.due = math.inf  # no more frames
    swimming.loop.limits = SafetyLimits(**{**vars(WIDE), "pose_hold": 0.5, "pose_stop": 9.0})
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.HOLD, 5.0)
    swimming.ticks(lambda: abs(swimming.rows[-1]["command_rad"] - 0.15) < 1e-3, 3.0)
    swimming.ticks(lambda: abs(swimming.rows[-1]["motor_angle_rad"] - 0.15) < 0.06, 3.0)


def test_poses_that_jump_hold_the_swim_and_are_not_swum_by(swimming):
    swimming.swim()
    swimming.rig.station.shifted = (1.2, 0.0, 0.0)
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.HOLD, 10.0)
    assert swimming.loop.safety_status.reason is Reason.POSES_IMPLAUSIBLE
    assert abs(swimming.loop.poses.pose()[0] - swimming.rig.shaft.pose[0]) < 0.6


def test_a_swim_held_by_the_robot_s_own_signals_can_be_armed_again(swimming):
    swimming.swim()
    signals, wander = swimming.loop.signals, CHECKS[1]
    assert signals.expected is not None and wander.sign == "wander"
    signals.signs["wander"], signals.broken[wander.text] = 7.0, 3
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.HOLD)
    assert swimming.loop.safety_status.reason is Reason.SIGNALS_DISAGREE
    swimming.ticks(lambda: swimming.loop.arm(time.monotonic()).state is State.ARMED, 10.0)


def test_an_answer_that_is_no_number_is_held_and_not_sent(swimming, monkeypatch):
    swimming.swim()
    swimming.ticks(
        lambda: swimming.rows[-1]["state"] == "run" and abs(swimming.loop.torque.sent) > 0.2
    )
    nothing = np.full((1, 6), np.nan, np.float32)
    monkeypatch.setattr("tailbeat.control.runner.decide", lambda *_: nothing)
    sent = [swimming.loop.torque.sent]

    def held() -> bool:
        sent.append(swimming.loop.torque.sent)
        return swimming.loop.safety_status.state is State.HOLD

    swimming.ticks(held, 3.0)
    assert "not a number" in swimming.loop.safety_status.text
    swimming.ticks(lambda: held() and abs(sent[-1]) < 0.01, 10.0)  # back to straight, slowly
    assert np.abs(np.diff(sent)).max() <= 1.0 * 0.02 + 0.002  # at 1 rad/s; a count is 1.5 mrad


def test_a_servo_that_shuts_down_or_restarts_stops_the_swim(swimming):
    swimming.swim()
    swimming.rig.servo.fail(2)
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 3.0)
    assert "hardware error" in swimming.loop.safety_status.text
    swimming.rig.servo.put(70, 0)
    swimming.loop.disarm()
    swimming.ticks(lambda: not swimming.loop.sensors.servo.alert)
    swimming.swim()
    swimming.rig.servo.reboot()
    swimming.rig.servo.quiet_until = 0.0
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 3.0)
    assert "lost its torque" in swimming.loop.safety_status.text and swimming.torque == 0


def test_a_pulled_servo_stops_and_an_exception_lets_go(swimming):
    swimming.swim()
    with pytest.raises(RuntimeError):
        swimming.loop.run(lambda since: (_ for _ in ()).throw(RuntimeError("a bug")))
    assert swimming.torque == 0
    swimming.loop.disarm()
    swimming.swim()
    swimming.rig.servo.faults.mute = 10**6
    swimming.loop.devices.servo.deadline = 0.02
    swimming.loop.limits = SafetyLimits(**{**vars(WIDE), "servo_hold": 0.3, "servo_stop": 0.6})
    swimming.ticks(lambda: swimming.loop.safety_status.state is State.STOP, 5.0)
    assert "no servo for" in swimming.loop.safety_status.text
    swimming.rig.servo.faults.mute = 0


# ---- the verbs ----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_drive_swims_its_own_rig_and_its_log_is_a_recording(tmp_path: Path):
    """In real time, in processes of their own. A host that takes its cores away makes the loop hold
    before it swims, as it should: then once more."""
    out, found = tmp_path / "swim.csv", {}
    for attempt in range(4):
        log = tmp_path / f"swim{attempt}.mcap"
        told = tmp_path / f"drive{attempt}.json"
        words = ("--emulated", "--log", log, "--seconds", 10, "--json", told)
        done = tailbeat_process("drive", "pulley-fish-pool-generator", *words)
        assert done.returncode in (0, 1), done.stderr
        found = json.loads(told.read_text())
        if found["swum_s"] > 0.5:
            break
    assert "run: swimming" in done.stdout
    assert found["rate_hz"] > 25 and found["rejected_datagrams"] == {}
    assert tailbeat_process("export", log, "--out", out).returncode == 0
    assert read_recording(out).time.size > 60


def test_what_a_drive_cannot_have_is_one_sentence_and_exit_code_2(tmp_path: Path):
    policy, log = "pulley-fish-pool-generator", tmp_path / "a.mcap"
    for words, complaint in {
        (policy,): "give --servo, --imu, --listen, --station and --key, or --emulated",
        (policy, "--emulated", "--target", "9,9"): "outside the pool",
        (policy, "--emulated", "--target", "left"): "give x,y in metres",
        (policy, "--target", "4,1.6"): "give --servo",  # the real pool may be larger
        (policy, "--target", "51,0"): "outside the pool",
        ("nobody", "--emulated"): "no such file",
    }.items():
        done = tailbeat("drive", *words, "--log", log)
        assert done.returncode == 2, done.stdout
        assert complaint in " ".join(done.stderr.split()) and "Traceback" not in done.stderr
    assert not log.exists()
