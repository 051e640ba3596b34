"""Maps and the status as ROS 2 messages, made as plain records."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from make_map import make_map, make_poses
from slam_init_ros.ros_messages import RosMessages

from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict
from slam_init.types.status import State, Status


def make(kind, **fields):
    return SimpleNamespace(kind=kind, **fields)


def edge(message):
    (sent,) = message.transforms
    q, t = sent.transform.rotation, sent.transform.translation
    pose = Pose.from_quaternion(np.array([q.w, q.x, q.y, q.z]), np.array([t.x, t.y, t.z]))
    return sent.header.frame_id, sent.child_frame_id, pose


def test_a_camera_that_has_a_parent_becomes_the_parent_of_the_map_by_the_inverse_transforms():
    view = Keyframe(3, 1.5, "1.500000000", make_poses(4)[3])
    frames = {"map_frame": "m", "camera_frame": "c", "world_frame": "w"}
    child, parent = RosMessages(make, **frames), RosMessages(make, **frames, camera_is_child=False)
    assert edge(child.camera(view))[:2] == ("m", "c") and edge(parent.camera(view))[:2] == ("c", "m")
    assert edge(child.upright(0))[:2] == ("w", "m") and edge(parent.upright(0))[:2] == ("m", "w")
    for one, other in ((child.camera(view), parent.camera(view)), (child.upright(0), parent.upright(0))):
        product = edge(one)[2] @ edge(other)[2]
        np.testing.assert_allclose(product.matrix(), np.eye(4), atol=1e-12)
    # No frame has two parents, either way.
    for messages in (child, parent):
        children = [edge(one)[1] for one in (messages.camera(view), messages.upright(0))]
        assert len(set(children)) == 2


def test_stamps_keep_the_nanoseconds_that_seconds_as_a_float_lose():
    exact = 1_700_000_000_123_456_789
    view = Keyframe(0, exact / 1e9, "", Pose.identity())
    assert RosMessages(make).camera(view).transforms[0].header.stamp.nanosec != 123_456_789
    kept = RosMessages(make, stamp_ns=lambda view: exact).camera(view).transforms[0].header.stamp
    assert (kept.sec, kept.nanosec) == (1_700_000_000, 123_456_789)


WAITING = Status(State.WAITING, 0.25, Verdict.PURE_ROTATION, Verdict.PURE_ROTATION.advice)


@pytest.mark.parametrize(
    ("status", "has_map", "lost", "level", "state", "said"),
    [
        (WAITING, False, False, 1, "waiting", "25%, pure_rotation: " + Verdict.PURE_ROTATION.advice),
        (Status.initialized(None), True, False, 0, "initialized", "initialized"),
        (Status.initialized(None), True, True, 2, "lost", "lost"),
        (Status(), False, True, 1, "lost", "0%, too_few_frames: " + Verdict.TOO_FEW_FRAMES.advice),
    ],
    ids=["waiting", "map", "lost", "a new start"],
)
def test_the_status_has_a_level_a_line_and_values(status, has_map, lost, level, state, said):
    map_ = make_map() if has_map else None
    message = RosMessages(make, camera_frame="cam").status(5, status, map_, maps=2, lost=lost)
    (one,) = message.status
    values = {pair.key: pair.value for pair in one.values}
    assert (one.level, one.message, one.hardware_id) == (level, said, "cam")
    assert values["state"] == state and values["maps"] == "2" and values["risk"] == ""
    assert values["landmarks"] == ("60" if has_map else "0") and values["unit"] == ("median depth" if has_map else "")
    assert all(isinstance(value, str) for value in values.values())
