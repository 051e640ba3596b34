"""Writers of ROS bags for tests."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

POSE, ODOMETRY, TRANSFORM = "PoseStamped", "Odometry", "TransformStamped"
FORMATS = ("ros1", "sqlite3", "mcap")


@dataclass
class Messages:
    """Messages for a bag of one format, with a shorthand for each type.

    ``sent`` holds (topic, type, time in ns, message).
    """

    kind: str
    sent: list[tuple[str, str, int, object]] = field(default_factory=list)

    def __post_init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.store = get_typestore(Stores.ROS1_NOETIC if self.kind == "ros1" else Stores.ROS2_HUMBLE)
        if self.kind == "ros1":
            self.store.register(
                get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
            )

    def make(self, type_: str, **fields: Any) -> Any:
        return self.store.types[type_](**fields)

    def header(self, time_s: float, frame: str) -> object:
        ns = round(time_s * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        number = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **number)

    def send(self, topic: str, type_: str, time_s: float, **fields: Any) -> None:
        self.sent.append((topic, type_, round(time_s * 1e9), self.make(type_, **fields)))

    def image(
        self, topic: str, time_s: float, pixels: np.ndarray, encoding: str, frame: str = "cam", **more: Any
    ) -> None:
        data = np.ascontiguousarray(pixels)
        fields = {
            "height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding, "is_bigendian": 0,
            "step": data.nbytes // pixels.shape[0],
        } | more  # fmt: skip
        stamp_s = fields.pop("stamp_s", time_s)
        data = data.view(np.uint8).ravel()
        header = self.header(stamp_s, frame)
        self.send(topic, "sensor_msgs/msg/Image", time_s, header=header, data=data, **fields)

    def compressed(self, topic: str, time_s: float, data: bytes, format_: str, frame: str = "cam") -> None:
        self.send(
            topic, "sensor_msgs/msg/CompressedImage", time_s,
            header=self.header(time_s, frame), format=format_, data=np.frombuffer(data, np.uint8),
        )  # fmt: skip

    def camera_info(
        self, topic: str, time_s: float, camera: Camera, model: str = "plumb_bob", frame: str = "cam", **more: Any
    ) -> None:
        K = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1.0])
        fields = {
            "d": np.array(camera.distortion or (0.0,) * 5), "k": K, "r": np.eye(3).ravel(),
            "p": np.insert(K, [3, 6, 9], 0.0),
        } | more  # fmt: skip
        if self.kind == "ros1":
            fields = {name.upper(): value for name, value in fields.items()}
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        self.send(
            topic, "sensor_msgs/msg/CameraInfo", time_s, header=self.header(time_s, frame), height=camera.height,
            width=camera.width, distortion_model=model, binning_x=0, binning_y=0, roi=region, **fields,
        )  # fmt: skip

    def pose(self, topic: str, time_s: float, pose: Pose, kind: str = POSE, child: str = "body") -> None:
        header = self.header(time_s, "world")
        if kind == TRANSFORM:
            fields = vars(self.transform(time_s, "world", child, pose))
            self.send(topic, "geometry_msgs/msg/TransformStamped", time_s, **fields)
            return
        value = self.make("geometry_msgs/msg/Pose", position=self._vector("Point", pose), orientation=self._turn(pose))
        if kind == POSE:
            self.send(topic, "geometry_msgs/msg/PoseStamped", time_s, header=header, pose=value)
            return
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        self.send(
            topic, "nav_msgs/msg/Odometry", time_s, header=header, child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=value, covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip

    def transform(self, time_s: float, parent: str, child: str, pose: Pose) -> object:
        value = self.make(
            "geometry_msgs/msg/Transform", translation=self._vector("Vector3", pose), rotation=self._turn(pose)
        )
        header = self.header(time_s, parent)
        return self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=value)

    def tf(self, topic: str, time_s: float, *transforms: object) -> None:
        self.send(topic, "tf2_msgs/msg/TFMessage", time_s, transforms=list(transforms))

    def write(self, path: Path, **options: Any) -> Path:
        """Write the bag; ``options`` go to the writer of rosbags."""
        writer: Any
        if self.kind == "ros1":
            from rosbags import rosbag1

            writer, serialize = rosbag1.Writer(path), self.store.serialize_ros1
        else:
            from rosbags import rosbag2

            plugin = rosbag2.StoragePlugin.SQLITE3 if self.kind == "sqlite3" else rosbag2.StoragePlugin.MCAP
            writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
            serialize = self.store.serialize_cdr
        if "compression" in options:
            writer.set_compression(*options["compression"])
        with writer:
            connections = {}
            for topic, type_, _, _ in self.sent:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, type_, typestore=self.store)
            for topic, type_, time_ns, message in sorted(self.sent, key=lambda each: each[2]):
                writer.write(connections[topic], time_ns, serialize(message, type_))
        return path

    def _vector(self, name: str, pose: Pose) -> object:
        return self.make(f"geometry_msgs/msg/{name}", **dict(zip("xyz", map(float, pose.t), strict=True)))

    def _turn(self, pose: Pose) -> object:
        return self.make("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", map(float, pose.q_wxyz), strict=True)))


def path_for(folder: Path, kind: str) -> Path:
    """The path of a bag: a file of ROS 1, a folder of ROS 2."""
    return folder / ("a bag é.bag" if kind == "ros1" else "a bag é")


def small_bag(kind: str, images: Iterable[np.ndarray], camera: Camera) -> Messages:
    """Grey images at 10 Hz from second 100 on, with a calibration and a pose each."""
    messages = Messages(kind)
    for k, image in enumerate(images):
        time_s = 100 + k / 10
        messages.image("/cam/image_raw", time_s, image, "mono8")
        messages.camera_info("/cam/camera_info", time_s, camera)
        messages.pose("/pose", time_s, Pose(np.eye(3), np.array([k / 10, 0.0, 0.0])))
    return messages
