"""The map as a recording of ROS 2 messages in MCAP, which Foxglove and ``ros2 bag`` open: ``map.mcap``.

* ``/tf_static`` (``tf2_msgs/TFMessage``): ``world`` to ``map``; ``world`` has x forward, y left, z up (REP 103).
* ``/tf`` (``tf2_msgs/TFMessage``): ``map`` to ``camera``, of each keyframe and each located frame.
* ``/keyframes`` (``geometry_msgs/PoseWithCovarianceStamped``): each keyframe in ``map``.
* ``/path`` (``nav_msgs/Path``): all of these poses.
* ``/points`` (``sensor_msgs/PointCloud2``): the landmarks in ``map``: x, y, z, rgb.

``map`` and ``camera`` are optical frames (x right, y down, z forward). Path and points have the time of the first
keyframe, so that a player shows them from the start. A covariance in ROS is in the axes of ``map``, position first:
with ``T = T0 exp(w, v)`` in the camera frame, as gtsam has it, the rotation vector in ``map`` is ``R w``, and the
position moves by ``R v``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: ``world_from_map``: x of ``world`` is z of ``map``, y is -x, z is -y.
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def ros_covariance(world_from_cam: Pose, covariance: Floats) -> Floats:
    """Convert a covariance of a pose from gtsam's tangent space to that of ROS.

    Shapes: ``covariance`` (6, 6), returns (6, 6).
    """
    R = world_from_cam.R
    jacobian = np.block([[np.zeros((3, 3)), R], [R, np.zeros((3, 3))]])
    return np.asarray(jacobian @ covariance @ jacobian.T)


def mcap_bytes(map_: InitialMap, located: Sequence[Keyframe] = ()) -> bytes:
    """Write the recording."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    messages = _Messages(get_typestore(Stores.ROS2_HUMBLE))
    views = sorted({one.frame: one for one in (*located, *map_.keyframes)}.values(), key=lambda one: one.frame)
    start = views[0].timestamp_s
    path = [messages.stamped("PoseStamped", one, pose=messages.pose(one.world_from_cam)) for one in views]
    sent: list[tuple[str, float, Any]] = [
        ("/tf_static", start, messages.transform(start, "world", "map", Pose(_UPRIGHT, np.zeros(3)))),
        ("/points", start, messages.points(start, map_)),
        ("/path", start, messages.make("nav_msgs/msg/Path", header=messages.header(start, "map"), poses=path)),
    ]
    covariances = dict(zip((one.frame for one in map_.keyframes), map_.pose_covariances, strict=True))
    for one in views:
        sent.append(("/tf", one.timestamp_s, messages.transform(one.timestamp_s, "map", "camera", one.world_from_cam)))
        if one.frame in covariances:
            covariance = ros_covariance(one.world_from_cam, covariances[one.frame]).ravel()
            pose = messages.make(
                "geometry_msgs/msg/PoseWithCovariance", pose=messages.pose(one.world_from_cam), covariance=covariance
            )
            sent.append(("/keyframes", one.timestamp_s, messages.stamped("PoseWithCovarianceStamped", one, pose=pose)))
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "map"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {
                topic: writer.add_connection(topic, message.__msgtype__, typestore=messages.store)
                for topic, message in {topic: message for topic, _, message in sent}.items()
            }
            for topic, time_s, message in sent:
                raw = messages.store.serialize_cdr(message, message.__msgtype__)
                writer.write(topics[topic], _nanoseconds(time_s), raw)
        return next(bag.glob("*.mcap")).read_bytes()


def _nanoseconds(time_s: float) -> int:
    return round(1e9 * time_s)


class _Messages:
    """Makes messages of ROS 2."""

    def __init__(self, store: Typestore) -> None:
        self.store = store

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, time_s: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(_nanoseconds(time_s), 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def stamped(self, kind: str, view: Keyframe, **fields: Any) -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", header=self.header(view.timestamp_s, "map"), **fields)

    def _rotation(self, pose: Pose) -> Any:
        w, x, y, z = pose.q_wxyz.tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, pose: Pose) -> Any:
        place = self.make("geometry_msgs/msg/Point", **dict(zip("xyz", pose.t.tolist(), strict=True)))
        return self.make("geometry_msgs/msg/Pose", position=place, orientation=self._rotation(pose))

    def transform(self, time_s: float, parent: str, child: str, parent_from_child: Pose) -> Any:
        place = self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", parent_from_child.t.tolist(), strict=True)))
        transform = self.make(
            "geometry_msgs/msg/Transform", translation=place, rotation=self._rotation(parent_from_child)
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_s, parent), child_frame_id=child, transform=transform,
        )  # fmt: skip
        return self.make("tf2_msgs/msg/TFMessage", transforms=[stamped])

    def points(self, time_s: float, map_: InitialMap) -> Any:
        """The landmarks: x, y, z as float, and the colour as the bytes of one (b, g, r, 0), as PCL packs it."""
        data = np.zeros(len(map_.points), [("xyz", "<f4", 3), ("bgr", "u1", 3), ("a", "u1")])
        data["xyz"], data["bgr"] = map_.points, map_.colors[:, ::-1]
        make, float32 = self.make, 7
        fields = [
            make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=float32, count=1)
            for k, name in enumerate(("x", "y", "z", "rgb"))
        ]
        return make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(time_s, "map"), height=1, width=len(data), fields=fields, is_bigendian=False,
            point_step=data.itemsize, row_step=data.nbytes, data=np.frombuffer(data.tobytes(), np.uint8), is_dense=True,
        )  # fmt: skip
