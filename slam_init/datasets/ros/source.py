"""A source over the images of a bag. One image is read at a time."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

import numpy as np

from slam_init.datasets.image_files import SAMPLES, GreyLevels, check_size, frame_range
from slam_init.datasets.inertial import InertialSensor, of_sensor
from slam_init.datasets.ros.bag import Bag, Message, Topic
from slam_init.datasets.ros.messages import COMPRESSED, RAW, camera_of_info, decode, is_picture
from slam_init.datasets.ros.motion import read_sensor, read_truth
from slam_init.errors import SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import problem_of

# -- topics ----------------------------------------------------------------------------------------


CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
#: Types of messages with one pose each.
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
#: Given as the topic of the ground truth, it means that there is none.
NO_TRUTH = "none"


@dataclass(frozen=True)
class BagName:
    """A bag with the topics that the user has chosen, as text: ``PATH?topic=/cam0/image_raw&truth_topic=/pose``."""

    path: str
    #: Of the images.
    topic: str | None = None
    #: Of the true poses; ``none`` for no ground truth.
    truth_topic: str | None = None

    @staticmethod
    def parse(text: str) -> BagName | None:
        """Read the text form."""
        path, mark, query = text.rpartition("?")
        options = dict(parse_qsl(query))
        is_path = os.path.exists(user_path(text))  # noqa: PTH110 (a Path raises for a null byte)
        if not mark or not options or set(options) - {"topic", "truth_topic"} or is_path:
            return None
        return BagName(path, options.get("topic"), options.get("truth_topic"))

    def __str__(self) -> str:
        options = {"topic": self.topic, "truth_topic": self.truth_topic}
        query = urlencode({key: value for key, value in options.items() if value is not None}, safe="/")
        return f"{self.path}?{query}" if query else self.path


def image_topic(bag: Bag, name: str | None) -> tuple[Topic, tuple[str, ...]]:
    """Choose the topic of the images.

    Without a name it is the only one that holds pictures. A camera that is recorded both raw and compressed counts
    once, and its raw images are taken. Depth images are left out.
    """
    found = [topic for topic in bag.topics if topic.type in (RAW, COMPRESSED) and topic.count]
    if name is not None:
        return _named(bag, found, name, f"no images in the topic {name!r}: give --topic {_listed(found)}"), ()
    found = [topic for topic in found if is_picture(bag.first(topic).content)]
    if not found:
        others = ", ".join(topic.name for topic in bag.topics[:20]) or "nothing"
        raise SourceError(f"{bag.path}: holds no topic with images (sensor_msgs/Image, CompressedImage), but {others}")
    cameras: dict[str, list[Topic]] = {}
    for topic in sorted(found, key=lambda topic: (topic.type == COMPRESSED, topic.name)):
        cameras.setdefault(_camera(topic.name), []).append(topic)
    if len(cameras) > 1:
        raise SourceError(f"{bag.path}: holds several topics with images: choose one by --topic {_listed(found)}")
    (variants,) = cameras.values()
    left_out = ", ".join(topic.name for topic in variants[1:])
    return variants[0], (f"images of {variants[0].name}; the same camera is in {left_out}",) if left_out else ()


def info_topic(bag: Bag, images: Topic, frame_id: str) -> Topic | None:
    """Find the calibration of a topic of images.

    It is the ``camera_info`` beside the topic, as ROS names it; else the only one whose messages have the same frame.
    """
    infos = [topic for topic in bag.topics if topic.type == CAMERA_INFO and topic.count]
    beside = [topic for topic in infos if topic.name == f"{_camera(images.name)}/camera_info"]
    same = beside or [topic for topic in infos if frame_id and bag.first(topic).frame_id == frame_id]
    return same[0] if len(same) == 1 else None


def truth_topic(bag: Bag, name: str | None) -> tuple[Topic | None, tuple[str, ...]]:
    """Choose the topic of the true poses.

    Without a name it is the only one that holds poses.
    """
    poses = [topic for topic in bag.topics if topic.type in POSES and topic.count]
    if name == NO_TRUTH:
        return None, ()
    if name is not None:
        remedy = f"give --truth-topic {_listed(poses) or NO_TRUTH}"
        return _named(bag, poses, name, f"no poses in the topic {name!r}: {remedy}"), ()
    if len(poses) > 1:
        return None, (f"no ground truth: several topics hold poses: choose one by --truth-topic {_listed(poses)}",)
    return next(iter(poses), None), ()


def _named(bag: Bag, topics: Sequence[Topic], name: str, problem: str) -> Topic:
    """The topic of a name; the problem is the error where there is none."""
    for topic in topics:
        if topic.name.strip("/") == name.strip("/"):
            return topic
    raise SourceError(f"{bag.path}: {problem}")


def _listed(topics: Sequence[Topic]) -> str:
    return " or ".join(topic.name for topic in topics)


def _camera(name: str) -> str:
    """The name of the camera of a topic: ``/cam0`` of ``/cam0/image_raw`` and of ``/cam0/image_raw/compressed``."""
    name = re.sub(r"/compressed$", "", name)
    return str(Path(name).parent.as_posix()).rstrip("/")


# -- the source ------------------------------------------------------------------------------------


class RosSource:
    """A :class:`slam_init.types.frame.TimedSource` over a topic of images.

    The time stamp of a frame is that of the header of its message; where the first header has none, all frames have the
    times at which they were recorded. An image that does not come after the one before is left out and counted; frames
    are numbered without it. The length is the number of images in the index of the bag, an upper bound: a damaged bag
    holds fewer, and :attr:`notes` says so.

    Calibration and ground truth are read when they are asked for. The ground truth and :attr:`timestamps_s` go through
    the whole bag; :meth:`frames` does not.

    * ``path``: A file (``.bag``, ``.db3``, ``.mcap``) or the folder of a ROS 2 bag.
    * ``topic``: Of the images.
    * ``truth``: Topic of the true poses, or ``none``. By default the only one that holds poses.
    """

    gyroscope, inertial = of_sensor("gyroscope"), of_sensor("record")

    def __init__(self, path: Path, topic: str | None = None, truth: str | None = None) -> None:
        self.path, self.name = path, path.resolve().name
        self._left_out: set[int] = set()
        self._read_count: int | None = None
        self._sensor_notes: tuple[str, ...] = ()
        with Bag(path) as bag:
            self.kind = f"ros{bag.version}"
            self.topic, self._notes = image_topic(bag, topic)
            first = bag.first(self.topic)
            self._frame_id = first.frame_id
            # A recording of a simulation may begin at 0; otherwise 0 means that the driver has set no time.
            self._by_header = first.stamp_s != 0 or first.received_s < 1
            image = decode(first.place, first.content)
            self._size, self._levels = (image.shape[1], image.shape[0]), GreyLevels()
            if image.dtype == np.uint16:
                some = itertools.islice(bag.messages(self.topic), SAMPLES)
                self._levels = GreyLevels.of(decode(message.place, message.content) for message in some)
                self._notes += (self._levels.note,)
            self._info_topic = info_topic(bag, self.topic, self._frame_id)
            self._truth_topic, truth_notes = truth_topic(bag, truth)
        if not self._by_header:
            self._notes += ("the images have no time stamps: the times at which they were recorded are taken",)
        self._notes += truth_notes

    @cached_property
    def camera(self) -> Camera | None:
        """The calibration of the first ``CameraInfo``; None if there is none."""
        if self._info_topic is None:
            return None
        with Bag(self.path) as bag:
            info = bag.first(self._info_topic).content
        return camera_of_info(f"{self.path}: {self._info_topic.name}", info, self.topic.name, self._size)

    @property
    def groundtruth(self) -> Trajectory | None:
        """The poses of the camera; None if no topic has them."""
        return self._truth[0]

    @cached_property
    def _truth(self) -> tuple[Trajectory | None, tuple[str, ...]]:
        if self._truth_topic is None:
            return None, ()
        with Bag(self.path) as bag:
            return read_truth(bag, self._truth_topic, self._frame_id)

    @cached_property
    def _sensor(self) -> InertialSensor | None:
        with Bag(self.path) as bag:
            sensor, self._sensor_notes = read_sensor(bag, self._frame_id, by_header=self._by_header)
        return sensor

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of the frames in seconds, strictly increasing."""
        with Bag(self.path) as bag:
            return np.array([time_s for time_s, _ in self._timed(bag)])

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know.

        * Returns: The topics that were chosen, what the ground truth is, and images that were left out up to now.
        """
        notes = [*self._notes, *self._truth[1], *self._sensor_notes]
        if count := len(self._left_out):
            notes.append(f"{count} images whose time stamps do not come after the one before were left out")
        if self._read_count is not None and self._read_count < self.topic.count:
            names = f"the index of the bag names {self.topic.count} images of {self.topic.name}"
            notes.append(f"{names}, and {self._read_count} can be read: the bag is damaged, copy or recover it")
        return tuple(notes)

    def __len__(self) -> int:
        return self.topic.count

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order; each image is decoded when its frame is requested."""
        wanted = frame_range(len(self), start, max_frames, self.name)
        index = -1
        with Bag(self.path) as bag:
            for index, (time_s, message) in enumerate(itertools.islice(self._timed(bag), wanted.stop)):
                if index in wanted:
                    image = self._levels.reduced(decode(message.place, message.content))
                    check_size(message.place, (image.shape[1], image.shape[0]), self._size, "the first image")
                    yield Frame(index, time_s, f"frame-{index:06d}", image)
        if index < start:
            raise SourceError(f"{self.path}: {self.topic.name} ends before frame {start}")

    def _timed(self, bag: Bag) -> Iterator[tuple[float, Message]]:
        """The messages and their times, without those that come too late."""
        last_s, count = -np.inf, 0
        for count, message in enumerate(bag.messages(self.topic), start=1):
            time_s = message.stamp_s if self._by_header else message.received_s
            if problem := problem_of(time_s):
                raise SourceError(f"{message.place}: time stamp {time_s!r} {problem}")
            if time_s <= last_s:
                self._left_out.add(count)
                continue
            last_s = time_s
            yield time_s, message
        self._read_count = count
