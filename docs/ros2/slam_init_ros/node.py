"""A lifecycle node: images and their calibration in; status, transforms, keyframes, path and points out.

The messages are those of :mod:`slam_init_ros.ros_messages`, with the stamps of the images to the
nanosecond. ``docs/how-to/live.md`` lists topics and parameters.

Each activation is a run: the node takes images until there is a map, hands it over, and locates the images that follow
in it. Deactivation ends the run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from tf2_msgs.msg import TFMessage

from slam_init.calibration.files import AUTO, NUMBERS, load_camera
from slam_init.config import load_config
from slam_init.datasets.ros.messages import camera_of_info, decode
from slam_init.errors import ConfigError, SlamInitError
from slam_init.initializer import Initializer, load_all
from slam_init.mapping.follower import Follower
from slam_init.output.folder import chosen_folder
from slam_init.recording.recorder import Recorder
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.system.regular_file import kind_problem, user_path
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init_ros.messages import make_message, stamp_of
from slam_init_ros.ros_messages import RosMessages

#: Name and default of each parameter. The parameters are read when the node is configured.
PARAMETERS: dict[str, bool | int | str] = {
    "autostart": True,
    "camera": "",
    "compressed": False,
    "config": "",
    "map_frame": "map",
    "out": "",
    "queue": 5,
    "recording": "",
    "refine_frames": 0,
    "restart": True,
    "tf": "camera",  # the child of the transform between map and camera: camera, map or none
    "world_frame": "world",
}


class InitializerNode(LifecycleNode):
    """Takes images until there is a map, and locates the images that follow."""

    def __init__(self, **options: Any) -> None:
        super().__init__("slam_init", **options)
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
        self.topics: dict[str, Any] = {}
        self.inputs: list[Any] = []
        self._forget()

    def _forget(self) -> None:
        """Begin again: there is no calibration, no image, no map."""
        self._info: Any = None
        self._initializer: Initializer | None = None
        self._follower: Follower | None = None
        self._recorder, self._messages = Recorder(), RosMessages(make_message)
        self._images = self._maps = 0

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        """Read the parameters, make the publishers, and compile."""
        options = self._options = {name: self.get_parameter(name).value for name in PARAMETERS}
        try:
            frames = options["refine_frames"]
            self._config = load_config(options["config"] or None, {"refine_frames": None if frames < 0 else frames})
            if options["tf"] not in ("camera", "map", "none"):
                raise ConfigError(f"tf is {options['tf']!r}: name the child, camera or map, or none")
            _check_parameters(options)
        except SlamInitError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # A map has its keyframes at once: a subscriber that comes later gets all of them.
        all_latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind, qos in (
            ("~/status", DiagnosticArray, QoSProfile(depth=10)),
            ("~/keyframes", PoseWithCovarianceStamped, all_latched),
            ("~/path", PathMessage, latched),
            ("~/points", PointCloud2, latched),
            ("/tf", TFMessage, QoSProfile(depth=100)),
            ("/tf_static", TFMessage, latched),
        ):
            self.topics[topic] = self.create_lifecycle_publisher(kind, topic, qos)
        load_all()  # so that no image waits for the compiler
        return super().on_configure(state)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Begin a run: subscribe."""
        self._forget()
        compressed = self._options["compressed"]
        self._image_topic = self.resolve_topic_name("image") + ("/compressed" if compressed else "")
        # Publishers of either reliability match a subscriber that asks for none.
        qos = QoSProfile(depth=self._options["queue"], reliability=ReliabilityPolicy.BEST_EFFORT)
        self.inputs = [
            self.create_subscription(CameraInfo, "camera_info", self._on_info, qos),
            self.create_subscription(CompressedImage if compressed else Image, self._image_topic, self._on_image, qos),
        ]
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """End the run."""
        self.end()
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        """Drop the publishers, and with them the latched map."""
        done = super().on_cleanup(state)
        for publisher in self.topics.values():
            self.destroy_lifecycle_publisher(publisher)
        self.topics.clear()
        self._forget()
        return done

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        """End the run, if there is one."""
        self.end()
        return super().on_shutdown(state)

    def on_error(self, state: Any) -> TransitionCallbackReturn:
        """End the run, so that the node can be configured again."""
        self.end()
        return self.on_cleanup(state)

    def end(self) -> None:
        """Unsubscribe, and write the results."""
        for subscription in self.inputs:
            self.destroy_subscription(subscription)
        self.inputs.clear()
        try:
            if self._initializer is not None:
                self._initializer.finish()
                self._save(self._initializer)
            self._recorder.close()
        except SlamInitError as error:
            self.get_logger().error(str(error))

    def _save(self, initializer: Initializer) -> None:
        if self._options["out"]:
            initializer.result.save(self._options["out"])

    def _on_info(self, info: Any) -> None:
        if any(info.k):  # a driver without a calibration sends zeros
            self._info = info

    def _on_image(self, message: Any) -> None:
        try:
            stamp = message.header.stamp
            image = decode(self._image_topic, message)
            # The name keeps the stamp to the nanosecond, also in the results.
            name = f"{stamp.sec}.{stamp.nanosec:09d}"
            frame = Frame(self._images, stamp.sec + stamp.nanosec * 1e-9, name, image)
            self._images += 1
            if self._initializer is None:
                camera = self._camera((image.shape[1], image.shape[0]))
                if camera is None:
                    self.get_logger().info("waiting for camera_info", throttle_duration_sec=5.0)
                    return
                self._begin(camera, message.header.frame_id, stamp_of(frame))
            self._process(self._initializer, frame)
        except SlamInitError as error:  # an image that comes too late or has another size is left out
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def _camera(self, size: tuple[int, int]) -> Camera | None:
        """The calibration by the parameter ``camera``, else by ``camera_info``; None before it comes."""
        if self._options["camera"]:
            return load_camera(self._options["camera"], size)
        return None if self._info is None else camera_of_info("camera_info", self._info, self._image_topic, size)

    def _begin(self, camera: Camera, camera_frame: str, time_ns: int) -> None:
        if self._options["recording"]:
            path = Path(self._options["recording"])
            self._recorder = RerunRecorder(path, camera, self._image_topic, seed=self._config.seed)
        self._initializer = Initializer(camera, self._config, self._recorder)
        self._messages = RosMessages(
            make_message, self._options["map_frame"], camera_frame or "camera", self._options["world_frame"],
            self._options["tf"] == "camera", stamp_of,
        )  # fmt: skip
        if self._options["tf"] != "none":
            self.topics["/tf_static"].publish(self._messages.upright(time_ns))

    def _process(self, initializer: Initializer, frame: Frame) -> None:
        lost = False
        if self._follower is None:
            status = initializer.process(frame)
            map_ = initializer.map if status and not status.refining else None
            if map_ is not None:
                self._follower = Follower(map_, initializer.tracker, self._recorder)
                self._export(initializer, map_, stamp_of(frame))
        else:
            lost = not self._locate(initializer, self._follower, frame)
            status, map_ = initializer.status, initializer.map
        said = self._messages.status(stamp_of(frame), status, map_, maps=self._maps, lost=lost)
        self.topics["~/status"].publish(said)

    def _export(self, initializer: Initializer, map_: InitialMap, time_ns: int) -> None:
        self._maps += 1
        for view, covariance in zip(map_.keyframes, map_.pose_covariances, strict=True):
            self.topics["~/keyframes"].publish(self._messages.keyframe(view, covariance))
            self._publish_tf(view)
        self.topics["~/path"].publish(self._messages.path(time_ns, map_.keyframes))
        self.topics["~/points"].publish(self._messages.points(time_ns, map_))
        self._save(initializer)

    def _locate(self, initializer: Initializer, follower: Follower, frame: Frame) -> bool:
        """Locate an image in the map, and return whether it was found. Where the map is lost, look for a new one."""
        view = follower.locate(frame)
        if view is not None:
            self._publish_tf(view)
        elif follower.lost_at is not None and self._options["restart"]:
            initializer.reset(since=follower.lost_at)
            self._follower = None
        return view is not None

    def _publish_tf(self, view: Keyframe) -> None:
        if self._options["tf"] != "none":
            self.topics["/tf"].publish(self._messages.camera(view))


def _check_parameters(options: dict[str, Any]) -> None:
    """Refuse what would fail at the first image, or at the end of the run."""
    if options["queue"] < 1:
        raise ConfigError(f"queue is {options['queue']}: one image or more has to wait")
    names = (options["map_frame"], options["world_frame"])
    if not all(names) or names[0] == names[1]:
        raise ConfigError(f"map_frame and world_frame are {names[0]!r} and {names[1]!r}: give two different names")
    camera = options["camera"]
    if camera in AUTO or camera.startswith(NUMBERS):
        load_camera(camera, (640, 480))
    elif camera and (problem := kind_problem(user_path(camera))):
        raise ConfigError(f"camera: {camera} {problem}")
    if options["out"]:
        chosen_folder(options["out"], "run")
    recording = Path(options["recording"]).absolute()
    if options["recording"] and (recording.is_dir() or not recording.parent.is_dir()):
        raise ConfigError(f"recording: {recording} can be no file: name one in a folder that exists")


def main() -> int:
    """Run the node until it is interrupted. With ``autostart`` it is active at once."""
    rclpy.init()
    node = InitializerNode()
    try:
        if node.get_parameter("autostart").value and node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            node.trigger_activate()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        node.end()
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
