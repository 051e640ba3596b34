"""A ROS 2 node: feeds the initializer from a camera, and publishes the map once there is one.

It subscribes to ``image`` (``sensor_msgs/Image``) and ``camera_info``, and publishes ``path`` (``nav_msgs/Path``) and
``points`` (``sensor_msgs/PointCloud2``), both latched, in the frame ``map``: the camera frame of the first keyframe, in
units of the median depth. Run it in an environment of ROS 2 in which slam-init is installed::

    python docs/examples/ros2_node.py --ros-args -r image:=/cam0/image_raw -r camera_info:=/cam0/camera_info

The tests run this module with stubs of rclpy and of the messages. They check its syntax and its calls of slam-init. It
was not run in ROS 2.
"""

from __future__ import annotations

import sys
from typing import Any

from slam_init.datasets.ros.messages import camera_of_info, decode
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer, load_all
from slam_init.types.initial_map import InitialMap


def make_node() -> Any:
    """Make the node.

    * Returns: With ``node``, a rclpy.node.Node, and ``initializer``: None before the first calibration.
    """
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo, Image, PointCloud2
    from sensor_msgs_py import point_cloud2
    from std_msgs.msg import Header

    class InitializerNode:
        """Takes images until there is a map."""

        def __init__(self) -> None:
            self.node = Node("slam_init")
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self.path = self.node.create_publisher(Path, "path", latched)
            self.points = self.node.create_publisher(PointCloud2, "points", latched)
            self.node.create_subscription(CameraInfo, "camera_info", self._on_info, qos_profile_sensor_data)
            self.node.create_subscription(Image, "image", self._on_image, qos_profile_sensor_data)
            self.initializer: Initializer | None = None
            load_all()  # so that no image waits for the compiler

        def _on_info(self, info: Any) -> None:
            if self.initializer is None:
                camera = camera_of_info("camera_info", info, "image", (info.width, info.height))
                if camera is not None:  # None: the driver sends no calibration
                    self.initializer = Initializer(camera)

        def _on_image(self, message: Any) -> None:
            if self.initializer is None or self.initializer.map is not None:
                return
            stamp = message.header.stamp
            try:
                status = self.initializer.process(decode("image", message), stamp.sec + stamp.nanosec * 1e-9)
            except SlamInitError as error:  # an image that comes too late, or of another size: leave it out
                self.node.get_logger().warning(str(error))
                return
            self.node.get_logger().info(f"{status.progress:.0%} {status.advice}", throttle_duration_sec=1.0)
            if self.initializer.map is not None:
                self._publish(self.initializer.map, Header(stamp=stamp, frame_id="map"))

        def _publish(self, map_: InitialMap, header: Any) -> None:
            path = Path(header=header)
            for keyframe in map_.keyframes:
                pose = PoseStamped(header=header)
                place, turn = pose.pose.position, pose.pose.orientation
                place.x, place.y, place.z = map(float, keyframe.world_from_cam.t)
                turn.w, turn.x, turn.y, turn.z = map(float, keyframe.world_from_cam.q_wxyz)
                path.poses.append(pose)
            self.path.publish(path)
            self.points.publish(point_cloud2.create_cloud_xyz32(header, map_.points.tolist()))

    return InitializerNode()


def main() -> int:
    """Run the node until it is interrupted."""
    import rclpy

    rclpy.init()
    node = make_node().node
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
