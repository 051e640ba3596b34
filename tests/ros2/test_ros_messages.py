"""Maps and the status as ROS 2 messages, made as plain records."""

from types import SimpleNamespace

import numpy as np
from make_map import make_poses
from slam_init_ros.ros_messages import RosMessages

from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose


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
