"""The gate of poses: what the fish cannot have done since the last frame is not believed."""

from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import SECOND, Frame, Receiver
from tailbeat.robot.plausible import Bounds
from tailbeat.robot.poses import Poses
from tailbeat.robot.safety import SafetyLimits

KEY, RUN, FRAME_TIME = bytes(32), 5, SECOND // 60


def heard(*fish: tuple[float, float, float]) -> Poses:
    """Poses that came one by one, sixty a second, as real datagrams."""
    receiver = Receiver(KEY, (5.5, 2.7))
    poses = Poses(receiver, Bounds())
    frames = [Frame(k * FRAME_TIME, pose, (1.5, 0.5)) for k, pose in enumerate(fish, 1)]
    for count in range(1, len(frames) + 1):
        packet = link.pose_datagram(KEY, RUN, receiver.nonce, count, frames[:count])
        receiver.take(packet, count * FRAME_TIME)
        poses.update(SafetyLimits())
    assert not receiver.rejected
    return poses


def test_a_pose_that_jumps_is_left_out_and_counted_until_the_fish_is_back():
    jumped = heard((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), *[(0.8, 0.0, 0.0)] * 4)
    assert jumped.pose()[0] < 0.02 and jumped.jumps == 4
    back = heard((0.0, 0.0, 0.0), *[(0.8, 0.0, 0.0)] * 2, (0.02, 0.0, 0.0))
    assert 0.01 < back.pose()[0] < 0.03 and back.jumps == 0


def test_a_heading_that_turns_round_at_once_is_left_out():
    turned = heard((0.0, 0.0, 0.1), (0.0, 0.0, 0.1 - 3.1))
    assert turned.pose()[2] > 0 and turned.jumps == 1
    wrapped = heard((0.0, 0.0, 3.1), (0.0, 0.0, -3.1))
    assert wrapped.pose()[2] < 0 and wrapped.jumps == 0


def test_a_fish_that_swims_is_believed():
    swum = heard(*[(0.01 * k, 0.0, 0.02 * k) for k in range(30)])
    assert abs(swum.pose()[0] - 0.29) < 1e-6 and swum.jumps == 0 and swum.frames(0).shape == (3, 6)
