"""The whole chain in real time: plant, camera, tracker, network, servo and IMU, all processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tailbeat import laptop_tasks, swim_tasks
from tailbeat.evaluate.live_swim import tour_of
from tailbeat.evaluate.pool_swim import draw_targets
from tailbeat.files import BadInput
from tailbeat.fish.outline import guessed_shape, outline
from tailbeat.fish.store import load_fish
from tailbeat.identify.runs import tracked_pose
from tailbeat.swim import link
from tailbeat.swim.link import Order
from tailbeat.swim.safety import State
from tailbeat.swim.sender import Sender
from tailbeat.swim.status import Numbers, Status
from tailbeat.swim.tour import Tour

POLICY, FISH = "pulley-fish-pool-generator", load_fish("pulley-fish")


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list[str]]:
    out, said = tmp_path_factory.mktemp("live"), list[str]()
    done = swim_tasks.live(POLICY, FISH.name, None, 1, 0, out, said.append)
    return out, done, said


def test_a_fish_seen_by_the_camera_alone_swims_towards_its_target(swum):
    out, done, said = swum
    target = draw_targets(1, 0)[0]
    row = done["targets"][0]
    assert row["time [s]"] > 1.0, said
    assert row["closest [cm]"] < 100 * 0.8 * np.hypot(*target), said
    for name in ("report.html", "swim.mp4", "summary.json", "swim.mcap", "figures/swim.svg"):
        assert (out / name).stat().st_size > 1000 or name == "summary.json"
    assert any("lens" in line for line in said) and any("run" in line for line in said)


def test_the_log_is_read_for_the_targets_that_were_swum_to_alone(swum):
    out, done, _ = swum
    tour = tour_of(out / "swim.mcap", FISH, draw_targets(1, 0))
    assert tour.rows() == done["targets"]
    with pytest.raises(BadInput, match="other targets than these"):
        tour_of(out / "swim.mcap", FISH, draw_targets(1, 1))


def test_nothing_that_was_started_outlives_the_swim(swum):
    from psutil import process_iter

    held = [one.info["cmdline"] or [] for one in process_iter(["cmdline"])]
    ours = [line for line in held if "tailbeat" in line and "--tour" in line]
    assert not ours


def test_a_terminated_swim_takes_its_processes_along(tmp_path):
    from psutil import Process

    words = ["swim", "--headless", "--targets", "1", "--out", str(tmp_path)]
    with subprocess.Popen([sys.executable, "-m", "tailbeat", *words]) as swim:
        end = time.monotonic() + 120
        while len(children := Process(swim.pid).children(recursive=True)) < 3:
            assert time.monotonic() < end and swim.poll() is None
            time.sleep(0.2)
        os.kill(swim.pid, signal.SIGTERM)
        swim.wait(60)
    end = time.monotonic() + 20
    while any(one.is_running() and one.status() != "zombie" for one in children):
        assert time.monotonic() < end, [one.cmdline() for one in children if one.is_running()]
        time.sleep(0.2)


def test_a_guessed_shape_has_its_tag_where_it_was_seen():
    pose = np.array([0.4, -0.3, 2.0])
    shape = guessed_shape(FISH, pose, 0.0)
    assert tracked_pose(FISH, shape[:3]) == pytest.approx(pose)
    left = outline(FISH, guessed_shape(FISH, [0.0, 0.0, 0.0], 0.5))[-1]
    assert left[1] > 0.02  # a positive motor angle bends the tip to the left


def test_a_leader_arms_anew_a_fish_that_holds_and_gives_up_in_the_end():
    def stands(state: State) -> Status:
        return Status(state, "so it is", 0, 0, sender.orders, 0.0, Numbers())

    leader = laptop_tasks.Leader(Tour([(1.0, 0.0)]), ran=time.monotonic())
    sender = Sender(bytes(32), link.bind("127.0.0.1", 0), ("127.0.0.1", 9))
    sender.status = stands(State.HOLD)
    for step in range(100):
        leader.lead(sender, (0.0, 0.0, 0.0), 100.0 + step, lambda _: None)
    assert sender.orders == laptop_tasks.REARMED
    assert sender.target == (1.0, 0.0) and not leader.tour.way
    first, began = sender.pending[-1].order, leader.over()
    sender.status = stands(State.ARMED)
    leader.lead(sender, (0.0, 0.0, 0.0), 300.0, lambda _: None)
    assert [first, sender.pending[-1].order] == [Order.ARM, Order.SWIM]
    leader.ran = time.monotonic() - laptop_tasks.STUCK - 1
    assert [began, leader.over()] == [False, True]
    sender.socket.close()
