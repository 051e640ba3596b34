"""What a bag states about the motion of its camera: the true poses, and the record of an inertial sensor.

A topic of poses states where a body is in the world: the child frame of ``Odometry`` and ``TransformStamped``; for
``PoseStamped``, which names no body, the highest frame that does not move against the camera. The transform from the
body to the camera comes from the transforms of ``tf_static``, and from those of ``tf`` that are sent again and again
with one value, as ROS 1 does. Without it the poses of the body stand for those of the camera, and a note says so. The
sensor is the only topic of ``sensor_msgs/Imu``, brought to the camera by the transforms.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np

from slam_init.datasets.inertial import InertialSensor
from slam_init.datasets.ros.bag import Bag, Message, Topic
from slam_init.datasets.text import pose_from_quaternion, trajectory
from slam_init.errors import SourceError
from slam_init.types.pose import Pose, Trajectory

#: Types of messages with transforms between frames.
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_IMU = "sensor_msgs/msg/Imu"
# Fixed transforms that are sent again are equal up to the digits of a double.
_SAME = 1e-9
#: Drivers that are not synchronized stamp a message where they receive it: some milliseconds late.
_CLOCK_SIGMA_S = 0.005

#: For each frame that does not move against its parent: the parent, and ``parent_from_frame``.
FixedFrames: TypeAlias = dict[str, tuple[str, Pose]]


def read_fixed_frames(bag: Bag) -> FixedFrames:
    """Read the transforms of a bag that do not change."""
    edges: FixedFrames = {}
    moving = set()
    for topic in bag.topics:
        for message in bag.messages(topic) if topic.type in _TRANSFORMS else ():
            for each in message.content.transforms:
                pose = _pose(message.place, each.transform.translation, each.transform.rotation)
                parent, child = (str(name).lstrip("/") for name in (each.header.frame_id, each.child_frame_id))
                known_parent, known = edges.setdefault(child, (parent, pose))
                same = np.allclose(known.matrix(), pose.matrix(), rtol=0, atol=_SAME)
                if known_parent != parent or not same:
                    moving.add(child)
    return {child: edge for child, edge in edges.items() if child not in moving}


def fixed_above(edges: FixedFrames, frame: str) -> dict[str, Pose]:
    """The frames above a frame that do not move against it, and the pose of the frame in each; itself first."""
    found, name = {frame: Pose.identity()}, frame
    while name in edges and edges[name][0] not in found:  # a circle ends where it closes
        parent, parent_from_name = edges[name]
        found[parent] = parent_from_name @ found[name]
        name = parent
    return found


def fixed_between(edges: FixedFrames, target: str, source: str) -> Pose | None:
    """The transform ``target_from_source`` of frames that do not move against each other."""
    above_target, above_source = fixed_above(edges, target), fixed_above(edges, source)
    common = next((name for name in above_source if name in above_target), None)
    return None if common is None else above_target[common].inverse() @ above_source[common]


def read_truth(bag: Bag, topic: Topic, camera_frame: str) -> tuple[Trajectory | None, tuple[str, ...]]:
    """Read the true poses of the camera, and what they are, for the user. The whole topic is read."""
    stamped, named = [], ""
    for message in bag.messages(topic):
        named = str(getattr(message.content, "child_frame_id", "")).lstrip("/") or named
        stamped.append((message.stamp_s or message.received_s, _pose_of(message)))
    edges = read_fixed_frames(bag)
    *_, highest = fixed_above(edges, camera_frame)
    body = named or highest
    body_from_cam = fixed_between(edges, body, camera_frame) if named or body != camera_frame else None
    note = f"the ground truth is {topic.name} ({topic.type.rsplit('/', 1)[-1]})"
    if body_from_cam is None:
        of = f" from {body} to the camera" if named else " of the camera"
        return trajectory(stamped), (f"{note}: the pose of the body, since the bag has no transform{of}",)
    note += f": the pose of {body}" + ("" if named else ", as the camera is fixed to it")
    note += "" if body == camera_frame else f", with the transform from {body} to {camera_frame}"
    return trajectory([(time_s, pose @ body_from_cam) for time_s, pose in stamped]), (note,)


def _pose_of(message: Message) -> Pose:
    """The pose of a message, whichever type it has."""
    content = message.content
    if hasattr(content, "transform"):
        return _pose(message.place, content.transform.translation, content.transform.rotation)
    pose = content.pose.pose if hasattr(content.pose, "pose") else content.pose  # one level deeper with a covariance
    return _pose(message.place, pose.position, pose.orientation)


def _pose(place: str, position: Any, orientation: Any) -> Pose:
    t = [position.x, position.y, position.z]
    q_wxyz = [orientation.w, orientation.x, orientation.y, orientation.z]
    if not all(map(math.isfinite, (*t, *q_wxyz))):
        raise SourceError(f"{place}: a pose holds a number that is not finite")
    return pose_from_quaternion((place, ""), t, q_wxyz)


def read_sensor(bag: Bag, camera_frame: str, *, by_header: bool) -> tuple[InertialSensor | None, tuple[str, ...]]:
    """Read the rates and accelerations of an inertial sensor, or why there is none. The whole topic is read.

    * ``by_header``: Whether the times are those of the headers; else those of the recorder, as for the images.
    """
    topics = [topic for topic in bag.topics if topic.type == _IMU and topic.count]
    if len(topics) != 1:
        names = ", ".join(topic.name for topic in topics)
        return None, (f"no gyroscope is used: there are several ({names})",) if topics else ()
    (topic,) = topics
    imu_frame = bag.first(topic).frame_id
    # Drivers write one name for all of their sensors where nobody has set the frames: that states no rotation.
    cam_from_imu = None
    if imu_frame and camera_frame and imu_frame != camera_frame:
        cam_from_imu = fixed_between(read_fixed_frames(bag), camera_frame, imu_frame)
    if cam_from_imu is None:
        what = f"no transform states its rotation from {imu_frame or '(no frame)'} to {camera_frame or '(no frame)'}"
        return None, (f"the gyroscope {topic.name} is not used: {what}",)
    samples: dict[float, tuple[float, ...]] = {}
    for message in bag.messages(topic):
        rate, force = message.content.angular_velocity, message.content.linear_acceleration
        time_s = message.stamp_s if by_header else message.received_s
        if not all(map(math.isfinite, (time_s, rate.x, rate.y, rate.z))):
            raise SourceError(f"{message.place}: a rate is not finite: leave --imu out")
        # ROS writes -1 to the covariance of what a sensor does not measure.
        measured = message.content.linear_acceleration_covariance[0] >= 0
        forces = (force.x, force.y, force.z) if measured else (math.nan,) * 3
        samples.setdefault(time_s, (rate.x, rate.y, rate.z, *forces))
    if len(samples) < 2:
        return None, (f"the gyroscope {topic.name} is not used: its messages have no time stamps",)
    times_s, table = np.array(sorted(samples)), np.array([samples[time_s] for time_s in sorted(samples)])
    table = table if np.isfinite(table).all() else table[:, :3]
    return InertialSensor.made(times_s, table, cam_from_imu, {}, clock_sigma_s=_CLOCK_SIGMA_S, name=topic.name), ()
