"""The gyroscope of a bag: its only topic of ``sensor_msgs/Imu``, brought to the camera by the transforms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_init.datasets.gyroscope import Gyroscope, made_gyroscope
from slam_init.datasets.ros.bag import Bag
from slam_init.datasets.ros.truth import read_transforms
from slam_init.errors import SourceError

IMU = "sensor_msgs/msg/Imu"
#: Most samples that are read: an hour and a half at 200 Hz.
_MAX_SAMPLES = 1_000_000
#: Drivers that are not synchronized stamp a message where they receive it: some milliseconds late.
_CLOCK_SIGMA_S = 0.005


@dataclass(frozen=True, eq=False)
class BagGyroscope:
    """The gyroscope of a bag, or why there is none."""

    gyroscope: Gyroscope | None
    #: For the user.
    notes: tuple[str, ...] = ()


def read_gyroscope(bag: Bag, camera_frame: str, *, by_header: bool) -> BagGyroscope:
    """Read the rates of a gyroscope. The whole topic is read.

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
    samples: dict[float, tuple[float, float, float]] = {}
    for number, message in enumerate(bag.messages(topic.name)):
        rate = bag.decoded(message, topic).angular_velocity
        time_s = bag.header_of(message, topic).stamp_s if by_header else message.received_s
        if not all(map(math.isfinite, (time_s, rate.x, rate.y, rate.z))):
            raise SourceError(f"{bag.path}: {topic.name}, message {number}: a rate is not finite: leave --imu out")
        samples.setdefault(time_s, (rate.x, rate.y, rate.z))
    if len(samples) < 2:
        return BagGyroscope(None, (f"the gyroscope {topic.name} is not used: its messages have no time stamps",))
    times_s = sorted(samples)
    rates = np.array([samples[time_s] for time_s in times_s])
    return BagGyroscope(
        made_gyroscope(np.array(times_s), rates, cam_from_imu.R, clock_sigma_s=_CLOCK_SIGMA_S, name=topic.name)
    )
