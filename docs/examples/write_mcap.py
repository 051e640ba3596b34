"""Write the map of a run as a recording of ROS 2 messages, which Foxglove and ``ros2 bag play`` open.

::

    slam-init run DATA/desk --continue 200 --out desk-run
    python docs/examples/write_mcap.py desk-run/handover.npz desk-mcap

* ``/tf_static``: ``world`` to ``map``; ``world`` has x forward, y left, z up (REP 103), ``map`` and ``camera`` are
  optical frames (x right, y down, z forward).
* ``/tf``: ``map`` to ``camera`` at each keyframe and each located frame.
* ``/path`` and ``/points``: all poses, and the landmarks with their colours.

A listener of transforms asks for transient local, so that the topics that are sent once are offered as such.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from slam_init.types.pose import Pose

STORE = get_typestore(Stores.ROS2_HUMBLE)
#: ``world_from_map``: x of ``world`` is z of ``map``, y is -x, z is -y.
UPRIGHT = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
_FLOAT32 = 7


def message(kind: str, **fields: object) -> Any:
    """Make a message of all its fields."""
    return STORE.types[kind](**fields)


def header(time_ns: int, frame: str) -> Any:
    """The header of a message."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    stamp = message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def parts(pose: Pose, vector: str) -> tuple[Any, Any]:
    """The translation and the rotation of a pose."""
    t = message(f"geometry_msgs/msg/{vector}", **dict(zip("xyz", pose.t.tolist(), strict=True)))
    return t, message("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", pose.q_wxyz.tolist(), strict=True)))


def transform(time_ns: int, parent: str, child: str, parent_from_child: Pose) -> Any:
    """A transform, for ``/tf`` and ``/tf_static``."""
    translation, rotation = parts(parent_from_child, "Vector3")
    stamped = message(
        "geometry_msgs/msg/TransformStamped",
        header=header(time_ns, parent),
        child_frame_id=child,
        transform=message("geometry_msgs/msg/Transform", translation=translation, rotation=rotation),
    )
    return message("tf2_msgs/msg/TFMessage", transforms=[stamped])


def pose_stamped(time_ns: int, pose: Pose) -> Any:
    """A pose in the map."""
    position, orientation = parts(pose, "Point")
    made = message("geometry_msgs/msg/Pose", position=position, orientation=orientation)
    return message("geometry_msgs/msg/PoseStamped", header=header(time_ns, "map"), pose=made)


def cloud(time_ns: int, points: NDArray[Any], colors: NDArray[Any]) -> Any:
    """The landmarks (L, 3) with their colours (L, 3): x, y, z, and one float of the bytes b, g, r, 0."""
    data = np.zeros(len(points), [("xyz", "<f4", 3), ("bgr", "u1", 3), ("a", "u1")])
    data["xyz"], data["bgr"] = points, colors[:, ::-1]
    fields = [
        message("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=_FLOAT32, count=1)
        for k, name in enumerate(("x", "y", "z", "rgb"))
    ]
    return message(
        "sensor_msgs/msg/PointCloud2",
        header=header(time_ns, "map"),
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=False,
        point_step=data.itemsize,
        row_step=data.nbytes,
        data=np.frombuffer(data.tobytes(), np.uint8),
        is_dense=True,
    )


def messages_of(path: str) -> list[tuple[str, int, Any]]:
    """The messages of ``handover.npz``: topic, time in nanoseconds, message."""
    with np.load(path, allow_pickle=False) as data:
        times_s = np.concatenate([data["keyframe_times"], data["located_times"]])
        matrices = np.concatenate([data["keyframe_poses"], data["located_poses"]])
        landmarks = cloud(round(1e9 * times_s.min()), data["points"], data["point_colors"])
    # A located frame may be a keyframe of a map that has grown.
    poses_by_time = {
        round(1e9 * time_s): Pose(matrix[:3, :3], matrix[:3, 3])
        for time_s, matrix in zip(times_s.tolist(), matrices, strict=True)
    }
    views = sorted(poses_by_time.items())
    start = views[0][0]
    poses = [pose_stamped(*view) for view in views]
    path_message = message("nav_msgs/msg/Path", header=header(start, "map"), poses=poses)
    once = [
        ("/tf_static", start, transform(start, "world", "map", UPRIGHT)),
        ("/points", start, landmarks),
        ("/path", start, path_message),
    ]
    return [*once, *(("/tf", time_ns, transform(time_ns, "map", "camera", pose)) for time_ns, pose in views)]


def write(messages: list[tuple[str, int, Any]], folder: Path) -> None:
    """Write a recording to a new folder. Version 8 writes policies as numbers, which all players read."""
    unlimited = QosTime(sec=9223372036, nsec=854775807)  # as ROS writes it: 2^63 - 1 ns
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        unlimited,
        unlimited,
        QosLiveliness.AUTOMATIC,
        unlimited,
        avoid_ros_namespace_conventions=False,
    )
    with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        topics: dict[str, Any] = {}
        for topic, time_ns, sent in messages:
            if topic not in topics:
                policies = [] if topic == "/tf" else [latched]
                topics[topic] = writer.add_connection(
                    topic, sent.__msgtype__, typestore=STORE, offered_qos_profiles=policies
                )
            writer.write(topics[topic], time_ns, STORE.serialize_cdr(sent, sent.__msgtype__))


def main() -> None:
    """Write the recording."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("handover", help="handover.npz of a run")
    parser.add_argument("out", type=Path, help="a new folder for the recording")
    arguments = parser.parse_args()
    write(messages_of(arguments.handover), arguments.out)


if __name__ == "__main__":
    main()
