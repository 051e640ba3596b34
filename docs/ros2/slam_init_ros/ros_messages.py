"""Maps and the status of an initializer as ROS 2 messages, for a recording and for a node alike.

The messages are made by a function of their type and their fields, so that this module knows neither rclpy nor rosbags.

``map`` and the frame of the camera are optical frames (x right, y down, z forward). A covariance in ROS is in the axes
of ``map``, position first: with ``T = T0 exp(w, v)`` in the camera frame, as gtsam has it, the rotation vector in
``map`` is ``R w``, and the position moves by ``R v``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose
from slam_init.types.status import Status

#: ``world_from_map``: x of ``world`` is z of ``map``, y is -x, z is -y (REP 103: x forward, y left, z up).
_UPRIGHT = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
#: The levels of ``diagnostic_msgs/DiagnosticStatus``.
_OK, _WARN, _ERROR = 0, 1, 2
#: ``FLOAT32`` of ``sensor_msgs/PointField``.
_FLOAT32 = 7


#: Makes a message of a type, such as ``geometry_msgs/msg/Pose``, from all of its fields by keyword. Arrays of bytes are
#: numpy arrays, and a byte is an int.
MakeMessage: TypeAlias = Callable[..., Any]


def stamp_ns(view: Keyframe) -> int:
    """The time stamp of a view in nanoseconds."""
    return round(1e9 * view.timestamp_s)


def ros_covariance(world_from_cam: Pose, covariance: Floats) -> Floats:
    """Convert a covariance of a pose from gtsam's tangent space to that of ROS.

    Shapes: ``covariance`` (6, 6), returns (6, 6).
    """
    R = world_from_cam.R
    jacobian = np.block([[np.zeros((3, 3)), R], [R, np.zeros((3, 3))]])
    return np.asarray(jacobian @ covariance @ jacobian.T)


@dataclass(frozen=True)
class RosMessages:
    """Makes the messages of a map.

    * ``camera_is_child``: Whether transforms go from ``world`` over ``map`` to the camera, or the other way. A frame of
      tf has one parent: the camera of a robot has one already.
    * ``stamp_ns``: The time stamp of a view. Seconds as a float lose up to 240 ns of a date.
    """

    make: MakeMessage
    map_frame: str = "map"
    camera_frame: str = "camera"
    world_frame: str = "world"
    camera_is_child: bool = True
    stamp_ns: Callable[[Keyframe], int] = stamp_ns

    def header(self, time_ns: int, frame: str) -> Any:
        """The header of a message."""
        seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def upright(self, time_ns: int) -> Any:
        """The transform between ``world`` and ``map``, for ``/tf_static``."""
        return self._transform(time_ns, self.world_frame, self.map_frame, _UPRIGHT)

    def camera(self, view: Keyframe) -> Any:
        """The transform between ``map`` and the camera at a view, for ``/tf``."""
        return self._transform(self.stamp_ns(view), self.map_frame, self.camera_frame, view.world_from_cam)

    def keyframe(self, view: Keyframe, covariance: Floats) -> Any:
        """The ``PoseWithCovarianceStamped`` of a keyframe.

        Shapes: ``covariance`` (6, 6) in gtsam's tangent space.
        """
        pose = self.make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self._pose(view.world_from_cam),
            covariance=ros_covariance(view.world_from_cam, covariance).ravel(),
        )
        return self._stamped("PoseWithCovarianceStamped", view, pose)

    def path(self, time_ns: int, views: Sequence[Keyframe]) -> Any:
        """The ``Path`` through views."""
        poses = [self._stamped("PoseStamped", one, self._pose(one.world_from_cam)) for one in views]
        return self.make("nav_msgs/msg/Path", header=self.header(time_ns, self.map_frame), poses=poses)

    def points(self, time_ns: int, map_: InitialMap) -> Any:
        """The landmarks: x, y, z as float, and the colour as the bytes of one (b, g, r, 0), as PCL packs it."""
        data = np.zeros(len(map_.points), [("xyz", "<f4", 3), ("bgr", "u1", 3), ("a", "u1")])
        data["xyz"], data["bgr"] = map_.points, map_.colors[:, ::-1]
        fields = [
            self.make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=_FLOAT32, count=1)
            for k, name in enumerate(("x", "y", "z", "rgb"))
        ]
        return self.make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(time_ns, self.map_frame), height=1, width=len(data), fields=fields, is_bigendian=False,
            point_step=data.itemsize, row_step=data.nbytes, data=np.frombuffer(data.tobytes(), np.uint8), is_dense=True,
        )  # fmt: skip

    def status(self, time_ns: int, status: Status, map_: InitialMap | None, *, maps: int, lost: bool = False) -> Any:
        """The status after an image as a ``DiagnosticArray``: OK with a map, WARN without one, ERROR where it is lost.

        * ``maps``: Number of maps up to now.
        * ``lost``: Whether the image could not be located in the map.
        """
        waiting = f"{status.progress:.0%}, {status.reason}: {status.advice}"
        level, text = (_WARN, waiting) if map_ is None else (_ERROR, "lost") if lost else (_OK, str(status.state))
        values = {
            "state": "lost" if lost else str(status.state),
            "progress": f"{status.progress:.3f}",
            "reason": str(status.reason or ""),
            "advice": status.advice,
            "risk": "" if status.risk is None else f"{status.risk:.4f}",
            "maps": str(maps),
            "keyframes": str(0 if map_ is None else len(map_.keyframes)),
            "landmarks": str(0 if map_ is None else len(map_.points)),
            "unit": "" if map_ is None else "median depth" if map_.scale is None else "m",
        }
        pairs = [self.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
        one = self.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level, name="slam_init", message=text, hardware_id=self.camera_frame, values=pairs,
        )  # fmt: skip
        header = self.header(time_ns, self.camera_frame)
        return self.make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[one])

    def _stamped(self, kind: str, view: Keyframe, pose: Any) -> Any:
        header = self.header(self.stamp_ns(view), self.map_frame)
        return self.make(f"geometry_msgs/msg/{kind}", header=header, pose=pose)

    def _xyz(self, kind: str, pose: Pose) -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", pose.t.tolist(), strict=True)))

    def _rotation(self, pose: Pose) -> Any:
        return self.make("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", pose.q_wxyz.tolist(), strict=True)))

    def _pose(self, pose: Pose) -> Any:
        return self.make("geometry_msgs/msg/Pose", position=self._xyz("Point", pose), orientation=self._rotation(pose))

    def _transform(self, time_ns: int, parent: str, child: str, parent_from_child: Pose) -> Any:
        if not self.camera_is_child:
            parent, child, parent_from_child = child, parent, parent_from_child.inverse()
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self._xyz("Vector3", parent_from_child),
            rotation=self._rotation(parent_from_child),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_ns, parent), child_frame_id=child, transform=transform,
        )  # fmt: skip
        return self.make("tf2_msgs/msg/TFMessage", transforms=[stamped])
