"""A source over the images of a bag. One image is read at a time."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from slam_init.datasets.grey_levels import SAMPLES, GreyLevels
from slam_init.datasets.image_files import MAX_FRAMES, check_size, frame_range
from slam_init.datasets.inertial import InertialSensor, WithSensor
from slam_init.datasets.ros.bag import Bag, Message
from slam_init.datasets.ros.messages import camera_of_info, decode
from slam_init.datasets.ros.motion import BagGyroscope, Truth, read_gyroscope, read_truth
from slam_init.datasets.ros.topics import image_topic, info_topic, truth_topic
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import problem_of


def open_ros(
    path: str | os.PathLike[str], version: int, topic: str | None = None, truth: str | None = None
) -> RosSource:
    """Open a bag.

    * ``path``: A file (``.bag``, ``.db3``, ``.mcap``) or the folder of a ROS 2 bag.
    * ``truth``: Topic of the true poses, or ``none``. By default the only one that holds poses, else that of the
      transforms.
    """
    return RosSource(Path(path), version, topic, truth)


class RosSource(WithSensor):
    """A :class:`slam_init.types.frame.TimedSource` over a topic of images.

    The time stamp of a frame is that of the header of its message; where the first header has none, all frames have the
    times at which they were recorded. An image that does not come after the one before is left out and counted; frames
    are numbered without it. The length is the number of images in the index of the bag, an upper bound: a damaged bag
    holds fewer, and :attr:`notes` says so.

    Calibration and ground truth are read when they are asked for. The ground truth and :attr:`timestamps_s` go through
    the whole bag; :meth:`frames` does not.

    * ``version``: 1 or 2, of ROS.
    * ``truth``: See :func:`open_ros`.
    * ``topic``: Of the images.
    """

    def __init__(self, path: Path, version: int, topic: str | None = None, truth: str | None = None) -> None:
        self.path, self._version = path, version
        self.name, self.kind = path.resolve().name, f"ros{version}"
        self._left_out: set[int] = set()
        self._read_count: int | None = None
        self._imu: BagGyroscope | None = None
        with Bag(path, version) as bag:
            self.topic, self._notes = image_topic(bag, topic)
            if self.topic.count > MAX_FRAMES:
                raise SourceError(f"{path}: {self.topic.name} holds more than {MAX_FRAMES} images: split the bag")
            first = bag.first(self.topic.name)
            if first is None:
                raise SourceError(f"{path}: {self.topic.name} holds no image: the index of the bag is wrong")
            header = bag.header_of(first, self.topic)
            self._frame_id = header.frame_id
            # A recording of a simulation may begin at 0; otherwise 0 means that the driver has set no time.
            self._by_header = header.stamp_s != 0 or first.received_s < 1
            image = decode(self._place(0), bag.decoded(first, self.topic))
            self._size, self._levels = (image.shape[1], image.shape[0]), GreyLevels()
            if image.dtype == np.uint16:
                some = enumerate(itertools.islice(bag.messages(self.topic.name), SAMPLES))
                decoded = (decode(self._place(k), bag.decoded(message, self.topic)) for k, message in some)
                self._levels = GreyLevels.of(decoded)
                self._notes += (self._levels.note,)
            self._info_topic = info_topic(bag, self.topic, self._frame_id)
            self._truth_topic, truth_notes = truth_topic(bag, truth)
        if not self._by_header:
            self._notes += ("the images have no time stamps: the times at which they were recorded are taken",)
        self._notes += truth_notes

    @cached_property
    def camera(self) -> Camera | None:
        """The calibration of the first ``CameraInfo``; None if there is none."""
        topic = self._info_topic
        if topic is None:
            return None
        with Bag(self.path, self._version) as bag:
            message = bag.first(topic.name)
            info = None if message is None else bag.decoded(message, topic)
        return None if info is None else camera_of_info(f"{self.path}: {topic.name}", info, self.topic.name, self._size)

    @property
    def groundtruth(self) -> Trajectory | None:
        """The poses of the camera; None if no topic tells them."""
        return self._truth.trajectory

    @property
    def _sensor(self) -> InertialSensor | None:
        if self._imu is None:
            with Bag(self.path, self._version) as bag:
                self._imu = read_gyroscope(bag, self._frame_id, by_header=self._by_header)
        return self._imu.sensor

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of the frames in seconds, strictly increasing."""
        with Bag(self.path, self._version) as bag:
            return np.array([time_s for _, time_s, _ in self._timed(bag)])

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know.

        * Returns: The topics that were chosen, what the ground truth is, and images that were left out up to now.
        """
        count = len(self._left_out)
        late = (f"{count} images whose time stamps do not come after the one before were left out",) if count else ()
        lost: tuple[str, ...] = ()
        if self._read_count is not None and self._read_count < self.topic.count:
            lost = (
                f"the index of the bag names {self.topic.count} images of {self.topic.name}, and "
                f"{self._read_count} can be read: the bag is damaged, copy it again or recover it",
            )
        return (*self._notes, *self._truth.notes, *(self._imu.notes if self._imu else ()), *late, *lost)

    def __len__(self) -> int:
        return self.topic.count

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order; each image is decoded when its frame is requested."""
        wanted = frame_range(len(self), start, max_frames, self.name)
        given = 0
        with Bag(self.path, self._version) as bag:
            for index, (image_number, time_s, message) in enumerate(self._timed(bag)):
                if index < wanted.start:
                    continue
                place = self._place(image_number)
                image = self._levels.reduced(decode(place, bag.decoded(message, self.topic)))
                check_size(place, (image.shape[1], image.shape[0]), self._size, "the first image")
                yield Frame(index, time_s, f"frame-{index:06d}", image)
                given += 1
                if given == len(wanted):
                    return
        if not given:
            raise SourceError(f"{self.path}: {self.topic.name} ends before frame {start}")

    @cached_property
    def _truth(self) -> Truth:
        topic = self._truth_topic
        if topic is None:
            return Truth(None, ())
        with Bag(self.path, self._version) as bag:
            return read_truth(bag, topic, self._frame_id)

    def _timed(self, bag: Bag) -> Iterator[tuple[int, float, Message]]:
        """The messages with their places in the topic and times, without those that come too late."""
        last_s: float | None = None
        index = -1
        for index, message in enumerate(bag.messages(self.topic.name)):
            time_s = bag.header_of(message, self.topic).stamp_s if self._by_header else message.received_s
            if problem := problem_of(time_s):
                raise SourceError(f"{self._place(index)}: time stamp {time_s!r} {problem}")
            if last_s is not None and time_s <= last_s:
                self._left_out.add(index)
                continue
            last_s = time_s
            yield index, time_s, message
        self._read_count = index + 1

    def _place(self, index: int) -> str:
        return f"{self.path}: {self.topic.name}, image {index}"
