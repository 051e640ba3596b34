"""The example that writes a map as a recording of ROS 2 messages: an independent reader finds the map in it."""

import numpy as np
import pytest
from make_map import make_map
from write_mcap import messages_of, write

from slam_init.output.handover import handover_bytes

pytestmark = pytest.mark.process

reader = pytest.importorskip("mcap_ros2.reader")


def test_a_reader_finds_the_poses_and_the_coloured_points(tmp_path):
    map_ = make_map()
    (tmp_path / "handover.npz").write_bytes(handover_bytes(map_))
    write(messages_of(str(tmp_path / "handover.npz")), tmp_path / "bag")
    sent = {}
    for one in reader.read_ros2_messages(str(next((tmp_path / "bag").glob("*.mcap")))):
        sent.setdefault(one.channel.topic, []).append(one)
    assert {topic: len(messages) for topic, messages in sent.items()} == {
        "/tf": len(map_.keyframes), "/tf_static": 1, "/path": 1, "/points": 1,
    }  # fmt: skip
    for one, view in zip(sent["/tf"], map_.keyframes, strict=True):
        (transform,) = one.ros_msg.transforms
        t = transform.transform.translation
        np.testing.assert_allclose([t.x, t.y, t.z], view.world_from_cam.t, atol=1e-12)
        assert (transform.child_frame_id, one.log_time_ns) == ("camera", round(1e9 * view.timestamp_s))
    data = np.frombuffer(bytes(sent["/points"][0].ros_msg.data), [("xyz", "<f4", 3), ("rgb", "<u4")])
    np.testing.assert_allclose(data["xyz"], map_.points, rtol=1e-6)
    rgb = np.column_stack([data["rgb"] >> 16 & 255, data["rgb"] >> 8 & 255, data["rgb"] & 255])
    np.testing.assert_array_equal(rgb, map_.colors)
