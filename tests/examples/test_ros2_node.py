"""The ROS 2 node, with stubs of rclpy and of the messages."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from make_files import picture
from make_map import make_map
from ros2_node import make_node

from slam_init.initializer import Initializer
from slam_init.types.camera import Camera


class StubNode:
    """Holds what the node subscribes to and publishes."""

    def __init__(self, name):
        self.callbacks, self.published, self.warnings = {}, {}, []

    def create_publisher(self, type_, topic, qos):
        return SimpleNamespace(publish=lambda message: self.published.setdefault(topic, message))

    def create_subscription(self, type_, topic, callback, qos):
        self.callbacks[topic] = callback

    def get_logger(self):
        return SimpleNamespace(info=lambda *_, **__: None, warning=self.warnings.append)


def message(**defaults):
    """A stub of a message type: keyword arguments become fields."""
    return lambda **fields: SimpleNamespace(**{name: make() for name, make in defaults.items()}, **fields)


@pytest.fixture
def ros(monkeypatch):
    """The modules of ROS 2 that the node imports."""

    def module(name, **content):
        stub = ModuleType(name)
        vars(stub).update(content)
        monkeypatch.setitem(sys.modules, name, stub)

    pose = lambda: SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())  # noqa: E731
    module("rclpy")
    module("rclpy.node", Node=StubNode)
    module(
        "rclpy.qos",
        DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL=1),
        QoSProfile=message(),
        qos_profile_sensor_data=None,
    )
    for package, types in {
        "geometry_msgs": {"PoseStamped": message(pose=pose)},
        "nav_msgs": {"Path": message(poses=list)},
        "sensor_msgs": {"CameraInfo": None, "Image": None, "PointCloud2": None},
        "std_msgs": {"Header": message()},
    }.items():
        module(package)
        module(f"{package}.msg", **types)
    cloud = SimpleNamespace(create_cloud_xyz32=lambda header, points: SimpleNamespace(header=header, points=points))
    module("sensor_msgs_py", point_cloud2=cloud)


def image(time_s: float, size=(64, 48)):
    ns = round(time_s * 1e9) + 10**18
    stamp = SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9)
    pixels = picture(0, size)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id="cam"), height=size[1], width=size[0], encoding="bgr8",
        is_bigendian=0, step=3 * size[0], data=pixels.ravel(),
    )  # fmt: skip


def test_the_node_feeds_its_images_and_publishes_the_map(ros, monkeypatch):
    found = make_map()
    # The scene allows no map; one appears with the third image.
    monkeypatch.setattr(Initializer, "map", property(lambda self: found if self.frames_read == 3 else None))
    monkeypatch.setattr("ros2_node.load_all", lambda: None)
    made = make_node()
    node = made.node
    node.callbacks["image"](image(0.0))
    assert made.initializer is None, "an image without a calibration"
    K = np.array([60, 0, 31.5, 0, 61, 23.5, 0, 0, 1.0])
    info = SimpleNamespace(k=0 * K, d=np.zeros(5), p=np.zeros(12), width=64, height=48, distortion_model="plumb_bob")
    node.callbacks["camera_info"](info)
    assert made.initializer is None, "a driver without a calibration"
    info.k = K
    node.callbacks["camera_info"](info)
    assert made.initializer.camera == Camera("pinhole", 64, 48, 60.0, 61.0, 31.5, 23.5)
    for time_s, size in ((0.1, (64, 48)), (0.05, (64, 48)), (0.2, (32, 24)), (0.2, (64, 48))):
        node.callbacks["image"](image(time_s, size))
    assert ["does not come after" in warning for warning in node.warnings] == [True, False]
    assert made.initializer.frames_read == 2 and node.published == {}
    node.callbacks["image"](image(0.3))
    path, points = node.published["path"], node.published["points"]
    assert len(path.poses) == len(found.keyframes) and len(points.points) == len(found.points)
    assert path.header.frame_id == "map" and path.header.stamp.nanosec == 300_000_000
    for sent, keyframe in zip(path.poses, found.keyframes, strict=True):
        place, turn = sent.pose.position, sent.pose.orientation
        np.testing.assert_array_equal([place.x, place.y, place.z], keyframe.world_from_cam.t)
        np.testing.assert_array_equal([turn.w, turn.x, turn.y, turn.z], keyframe.world_from_cam.q_wxyz)
    node.callbacks["image"](image(0.4))
    assert made.initializer.frames_read == 3, "images after the map are of no use"
