"""The whole chain in real time: plant, camera, tracker, network, servo and IMU, all processes."""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import time
from html import unescape
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")

from psutil import NoSuchProcess, Process, process_iter

from support import command, complaint, until
from tailbeat.cli import progress
from tailbeat.evaluate import swim
from tailbeat.evaluate.live_swim import tour_of
from tailbeat.files import BadInput
from tailbeat.fish.outline import guessed_shape, outline
from tailbeat.fish.store import load_fish
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Order
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import Numbers, State, Status
from tailbeat.operator import leader as leaders
from tailbeat.operator.tour import Tour, draw_targets
from tailbeat.report import tour as page
from tailbeat.robot.log import read_notes

pytestmark = pytest.mark.realtime

POLICY, FISH = "pulley-fish-pool-generator", load_fish("pulley-fish")


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, page.TourReport, list[str]]:
    out, said = tmp_path_factory.mktemp("live"), list[str]()
    config = swim.SwimConfig(POLICY, FISH.name, targets=1)
    done = page.write(swim.live(config, out, said.append), out, progress.counting, 1.0)
    return out, done, said


@pytest.mark.slow
def test_a_fish_seen_by_the_camera_alone_swims_towards_its_target(swum):
    out, done, said = swum
    target = draw_targets(1, 0)[0]
    row = done.targets[0]
    assert row.seconds > 0.1, said  # how far it comes is a matter of the machine's load
    assert row.closest < np.hypot(*target) + 0.5, said
    for name in ("report.html", "swim.mp4", "summary.json", "swim.mcap", "figures/swim.svg"):
        assert (out / name).stat().st_size > 1000 or name == "summary.json"
    assert any("lens" in line for line in said) and any("run" in line for line in said)


@pytest.mark.thorough
def test_the_log_is_read_for_the_targets_that_were_swum_to_alone(swum):
    out, done, _ = swum
    tour = tour_of(out / "swim.mcap", FISH, draw_targets(1, 0))
    assert np.abs(tour.targets - draw_targets(1, 0)).max() < 1e-12 and len(tour.pose) > 5
    closest = done.targets[0].closest
    assert tour.nearest[0] == pytest.approx(closest, abs=0.03)  # it swims until it hears STOP
    with pytest.raises(BadInput, match="swam to other targets"):
        tour_of(out / "swim.mcap", FISH, draw_targets(1, 1))


@pytest.mark.thorough
def test_the_log_s_head_names_the_calibration_of_the_station_s_camera(swum):
    assert re.fullmatch("sha256 [0-9a-f]{64}", read_notes(swum[0] / "swim.mcap")["calibration"])


@pytest.mark.thorough
def test_the_page_offers_the_command_that_corrects_the_policy(swum, tmp_path):
    """As it stands it reads this swim's log, which is too short to tell anything."""
    found = re.search("<pre>tailbeat (.*)</pre>", (swum[0] / "report.html").read_text())
    assert found
    said = complaint(*shlex.split(unescape(found[1])), cwd=tmp_path)
    assert "s or more; give 24 s or more without a gap" in said


def verbs(of: Path) -> set[str]:
    """Which of our verbs run that know a folder or whose parent's child does."""
    found = set()
    for one in process_iter(["cmdline"]):
        words = one.info["cmdline"] or []
        if str(of) in " ".join(words):
            found |= {"drive", "station", "swim"} & set(words)
    return found


@pytest.mark.thorough
def test_nothing_that_was_started_outlives_the_swim(swum):
    assert not verbs(swum[0])


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGKILL, marks=pytest.mark.thorough),
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_a_swim_that_is_ended_takes_its_processes_along(tmp_path, number):
    words = ["swim", "--headless", "--targets", "1", "--out", str(tmp_path)]
    with subprocess.Popen(command(*words)) as swim:
        until(lambda: "drive" in verbs(tmp_path) or swim.poll() is not None, seconds=180)
        children = Process(swim.pid).children(recursive=True)
        assert {"emulate", "drive"} <= {word for one in children for word in one.cmdline()}
        os.kill(swim.pid, number)
        swim.wait(60)
    until(lambda: not any(alive(one) for one in children))


def alive(one: Process) -> bool:
    with contextlib.suppress(NoSuchProcess):
        return one.is_running() and one.status() != "zombie"
    return False


def test_a_guessed_shape_has_its_tag_where_it_was_seen():
    pose = np.array([0.4, -0.3, 2.0])
    shape = guessed_shape(FISH, pose, 0.0)
    assert tracked_pose(FISH, shape[:3]) == pytest.approx(pose)
    left = outline(FISH, guessed_shape(FISH, [0.0, 0.0, 0.0], 0.5))[-1]
    assert left[1] > 0.02  # a positive motor angle bends the tip to the left


def test_a_leader_without_a_tour_names_its_first_target_once():
    sender = Sender(bytes(32), link.bind("127.0.0.1", 0), ("127.0.0.1", 9))
    leader = leaders.Leader(None, (1.5, 0.5))
    leader.lead(sender, None, 100.0, print)
    first, sender.target = sender.target, (0.0, 0.0)  # the operator drags it away
    leader.lead(sender, None, 100.1, print)
    assert first == (1.5, 0.5) and sender.target == (0.0, 0.0)
    sender.socket.close()


def test_a_leader_arms_anew_a_fish_that_holds_and_gives_up_in_the_end():
    def stands(state: State) -> Status:
        return Status(state, Reason.NO_TARGET, "so it is", 0, 0, sender.orders, 0.0, Numbers())

    tour = Tour([(1.0, 0.0)])
    leader = leaders.Leader(tour, ran=time.monotonic())
    sender = Sender(bytes(32), link.bind("127.0.0.1", 0), ("127.0.0.1", 9))
    sender.status = stands(State.HOLD)
    leader.armed, leader.swam, said = 1, True, list[str]()
    for step in range(100):
        sender.heard = 100.0 + step
        leader.lead(sender, (0.0, 0.0, 0.0), 100.0 + step, said.append)
    assert sender.orders == leaders.REARMED == leader.rearmed == len(said)
    assert sender.target == (1.0, 0.0) and tour.began is None
    first, began = sender.pending[-1].order, leader.over()
    sender.status = stands(State.ARMED)
    sender.heard = 300.0
    leader.lead(sender, (0.0, 0.0, 0.0), 300.0, said.append)
    assert [first, sender.pending[-1].order] == [Order.ARM, Order.SWIM]
    leader.ran = time.monotonic() - leaders.STUCK - 1
    assert [began, leader.over()] == [False, True]
    sender.socket.close()
