"""What a bag tells of the motion of its camera: the true poses, and the record of an inertial sensor.

A topic of poses tells where a body is in the world: the child frame of ``Odometry`` and ``TransformStamped``; for
``PoseStamped``, which names no body, the highest frame that does not move against the camera. The transform from the
body to the camera comes from ``tf_static`` and from the edges of ``tf`` that do not move. Without it the poses of the
body stand for those of the camera, and a note says so. A topic of transforms tells where the camera is in the root of
its tree. The sensor is the only topic of ``sensor_msgs/Imu``, brought to the camera by the transforms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from slam_init.datasets.inertial import InertialSensor
from slam_init.datasets.ros.bag import Bag, Message, Topic
from slam_init.datasets.ros.topics import TRANSFORMS
from slam_init.datasets.ros.transforms import StampedTransform, TransformTree
from slam_init.datasets.text import pose_from_quaternion, trajectory
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose, Trajectory

# -- true poses ------------------------------------------------------------------------------------


#: Most poses and transforms that are read: nine hours of one at 30 Hz, or an hour of nine at 30 Hz.
MAX_POSES = 1_000_000


@dataclass(frozen=True, eq=False)
class Truth:
    """The true trajectory of the camera."""

    #: None if the topic tells nothing about the camera.
    trajectory: Trajectory | None
    #: What the poses are, for the user.
    notes: tuple[str, ...]


def read_truth(bag: Bag, topic: Topic, camera_frame: str) -> Truth:
    """Read the true poses of the camera. The whole topic is read."""
    if topic.type in TRANSFORMS:
        return _of_transforms(bag, topic, camera_frame)
    if topic.count > MAX_POSES:
        raise SourceError(f"{bag.path}: {topic.name} holds more than {MAX_POSES} poses: give --truth-topic none")
    stamped, body = [], ""
    for place, message in _messages(bag, topic):
        decoded = bag.decoded(message, topic)
        body = str(getattr(decoded, "child_frame_id", "")).lstrip("/") or body
        stamped.append((_time_s(bag, message, topic), _pose(place, decoded)))
    tree, notes = read_transforms(bag)
    named = bool(body)
    body = body or tree.rigid_above(camera_frame)[-1]
    if body == camera_frame and named:
        body_from_cam: Pose | None = Pose.identity()
    else:
        body_from_cam = None if body == camera_frame else tree.rigid(body, camera_frame)
    note = f"the ground truth is {topic.name} ({topic.type.rsplit('/', 1)[-1]})"
    if body_from_cam is None:
        of = f" from {body} to the camera" if named else " of the camera"
        return Truth(trajectory(stamped), (*notes, f"{note}: the pose of the body, since the bag has no transform{of}"))
    note += f": the pose of {body}" + ("" if named else ", as the camera is fixed to it")
    note += "" if body == camera_frame else f", with the transform from {body} to {camera_frame}"
    return Truth(trajectory([(time_s, pose @ body_from_cam) for time_s, pose in stamped]), (*notes, note))


def _of_transforms(bag: Bag, topic: Topic, camera_frame: str) -> Truth:
    tree, notes = read_transforms(bag)
    root, stamped = tree.path_of(camera_frame)
    if not stamped:
        what = f"does not tell how {camera_frame} moves" if camera_frame else "cannot be used: the images name no frame"
        return Truth(None, (*notes, f"no ground truth: {topic.name} {what}"))
    note = f"the ground truth is {topic.name}: the pose of {camera_frame} in {root}, which the robot may have estimated"
    return Truth(trajectory(stamped), (*notes, note))


def read_transforms(bag: Bag) -> tuple[TransformTree, tuple[str, ...]]:
    """Read all transforms of a bag."""
    topics = [topic for topic in bag.topics if topic.type in TRANSFORMS]
    transforms: list[StampedTransform] = []
    for topic in topics:
        for place, message in _messages(bag, topic):
            transforms += _transforms(bag, place, message, topic)
            if len(transforms) > MAX_POSES:
                return TransformTree(), (f"more than {MAX_POSES} transforms: they were not read",)
    return TransformTree.gather(transforms), ()


def _transforms(bag: Bag, place: str, message: Message, topic: Topic) -> Iterator[StampedTransform]:
    for each in bag.decoded(message, topic).transforms:
        stamp = each.header.stamp
        t, q_wxyz = _parts(place, each.transform.translation, each.transform.rotation)
        parent, child = (str(name).lstrip("/") for name in (each.header.frame_id, each.child_frame_id))
        yield StampedTransform(stamp.sec + stamp.nanosec * 1e-9 or message.received_s, parent, child, t, q_wxyz)


def _messages(bag: Bag, topic: Topic) -> Iterator[tuple[str, Message]]:
    for number, message in enumerate(bag.messages(topic.name)):
        yield f"{bag.path}: {topic.name}, message {number}", message


def _time_s(bag: Bag, message: Message, topic: Topic) -> float:
    """The time of a message: that of its header where the sender has set one."""
    return bag.header_of(message, topic).stamp_s or message.received_s


def _pose(place: str, message: Any) -> Pose:
    """The pose of a message, whichever type it has."""
    if hasattr(message, "transform"):
        position, orientation = message.transform.translation, message.transform.rotation
    else:  # with a covariance, the pose lies one level deeper
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        position, orientation = pose.position, pose.orientation
    t, q_wxyz = _parts(place, position, orientation)
    return Pose.from_quaternion(q_wxyz, t)


def _parts(place: str, position: Any, orientation: Any) -> tuple[Floats, Floats]:
    """A checked translation and a unit quaternion, w first."""
    t = [position.x, position.y, position.z]
    q_wxyz = [orientation.w, orientation.x, orientation.y, orientation.z]
    if not all(map(math.isfinite, (*t, *q_wxyz))):
        raise SourceError(f"{place}: a pose holds a number that is not finite")
    pose_from_quaternion((place, ""), t, q_wxyz)
    q = np.array(q_wxyz)
    return np.array(t), q / np.linalg.norm(q)


# -- gyroscope -------------------------------------------------------------------------------------


IMU = "sensor_msgs/msg/Imu"
#: Most samples that are read: an hour and a half at 200 Hz.
_MAX_SAMPLES = 1_000_000
#: Drivers that are not synchronized stamp a message where they receive it: some milliseconds late.
_CLOCK_SIGMA_S = 0.005


@dataclass(frozen=True, eq=False)
class BagGyroscope:
    """The inertial sensor of a bag, or why there is none."""

    sensor: InertialSensor | None
    #: For the user.
    notes: tuple[str, ...] = ()


def read_gyroscope(bag: Bag, camera_frame: str, *, by_header: bool) -> BagGyroscope:
    """Read the rates and accelerations of an inertial sensor. The whole topic is read.

    * ``by_header``: Whether the times are those of the headers; else those of the recorder, as for the images.
    """
    topics = [topic for topic in bag.topics if topic.type == IMU and topic.count]
    if not topics:
        return BagGyroscope(None)
    names = ", ".join(topic.name for topic in topics)
    if len(topics) > 1:
        return BagGyroscope(None, (f"no gyroscope is used: there are several ({names})",))
    (topic,) = topics
    first = bag.first(topic.name)
    imu_frame = "" if first is None else bag.header_of(first, topic).frame_id.lstrip("/")
    # Drivers write one name for all of their sensors where nobody has set the frames: that tells no rotation.
    cam_from_imu = None
    if imu_frame and camera_frame and imu_frame != camera_frame:
        cam_from_imu = read_transforms(bag)[0].rigid(camera_frame, imu_frame)
    if cam_from_imu is None:
        what = f"no transform tells its rotation from {imu_frame or '(no frame)'} to {camera_frame or '(no frame)'}"
        return BagGyroscope(None, (f"the gyroscope {topic.name} is not used: {what}",))
    if topic.count > _MAX_SAMPLES:
        return BagGyroscope(None, (f"the gyroscope {topic.name} is not used: more than {_MAX_SAMPLES} samples",))
    samples: dict[float, tuple[float, ...]] = {}
    for number, message in enumerate(bag.messages(topic.name)):
        decoded = bag.decoded(message, topic)
        rate, force = decoded.angular_velocity, decoded.linear_acceleration
        time_s = bag.header_of(message, topic).stamp_s if by_header else message.received_s
        if not all(map(math.isfinite, (time_s, rate.x, rate.y, rate.z))):
            raise SourceError(f"{bag.path}: {topic.name}, message {number}: a rate is not finite: leave --imu out")
        # ROS writes -1 to the covariance of what a sensor does not measure.
        measured = decoded.linear_acceleration_covariance[0] >= 0 and np.isfinite([force.x, force.y, force.z]).all()
        forces = (force.x, force.y, force.z) if measured else (math.nan,) * 3
        samples.setdefault(time_s, (rate.x, rate.y, rate.z, *forces))
    if len(samples) < 2:
        return BagGyroscope(None, (f"the gyroscope {topic.name} is not used: its messages have no time stamps",))
    times_s = sorted(samples)
    table = np.array([samples[time_s] for time_s in times_s])
    table = table if np.isfinite(table).all() else table[:, :3]
    return BagGyroscope(
        InertialSensor.made(np.array(times_s), table, cam_from_imu, {}, clock_sigma_s=_CLOCK_SIGMA_S, name=topic.name)
    )
