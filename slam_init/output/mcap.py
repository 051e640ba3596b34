"""The map as a recording of ROS 2 messages in MCAP, which Foxglove and ``ros2 bag`` open: ``map.mcap``.

* ``/tf_static`` (``tf2_msgs/TFMessage``): ``world`` to ``map``; ``world`` has x forward, y left, z up (REP 103).
* ``/tf`` (``tf2_msgs/TFMessage``): ``map`` to ``camera``, of each keyframe and each located frame.
* ``/keyframes`` (``geometry_msgs/PoseWithCovarianceStamped``): each keyframe in ``map``.
* ``/path`` (``nav_msgs/Path``): all of these poses.
* ``/points`` (``sensor_msgs/PointCloud2``): the landmarks in ``map``: x, y, z, rgb.

Path and points have the time of the first keyframe, so that a player shows them from the start. A player offers the
topics that are sent once as transient local: listeners of transforms ask for it, and late ones get the message too.
:mod:`slam_init.output.ros_messages` makes the messages.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slam_init.output.ros_messages import RosMessages, stamp_ns
from slam_init.types.initial_map import InitialMap, Keyframe

#: Topics that are sent once.
_ONCE = frozenset({"/tf_static", "/points", "/path"})


def mcap_bytes(map_: InitialMap, located: Sequence[Keyframe] = ()) -> bytes:
    """Write the recording."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = RosMessages(lambda kind, **fields: store.types[kind](**fields))
    views = sorted({one.frame: one for one in (*located, *map_.keyframes)}.values(), key=lambda one: one.frame)
    start = stamp_ns(views[0])
    sent: list[tuple[str, int, Any]] = [
        ("/tf_static", start, messages.upright(start)),
        ("/points", start, messages.points(start, map_)),
        ("/path", start, messages.path(start, views)),
    ]
    unlimited = QosTime(sec=9223372036, nsec=854775807)  # as ROS writes it: 2^63 - 1 ns
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, unlimited, unlimited,
        QosLiveliness.AUTOMATIC, unlimited, avoid_ros_namespace_conventions=False,
    )  # fmt: skip
    covariances = dict(zip((one.frame for one in map_.keyframes), map_.pose_covariances, strict=True))
    for one in views:
        sent.append(("/tf", stamp_ns(one), messages.camera(one)))
        if one.frame in covariances:
            sent.append(("/keyframes", stamp_ns(one), messages.keyframe(one, covariances[one.frame])))
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "map"
        # Version 8 writes policies as numbers, which all players read; Humble reads no names.
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {
                topic: writer.add_connection(
                    topic, message.__msgtype__, typestore=store, offered_qos_profiles=[latched] * (topic in _ONCE)
                )
                for topic, message in {topic: message for topic, _, message in sent}.items()
            }
            for topic, time_ns, message in sent:
                writer.write(topics[topic], time_ns, store.serialize_cdr(message, message.__msgtype__))
        return next(bag.glob("*.mcap")).read_bytes()
