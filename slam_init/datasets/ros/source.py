"""A source over the images of a bag. One image is read at a time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from slam_init.datasets.grey_levels import SAMPLES, GreyLevels
from slam_init.datasets.image_files import check_size, frame_range
from slam_init.datasets.inertial import InertialSensor, of_sensor
from slam_init.datasets.ros.bag import Bag, Message
from slam_init.datasets.ros.messages import camera_of_info, decode
from slam_init.datasets.ros.motion import read_sensor, read_truth
from slam_init.datasets.ros.topics import image_topic, info_topic, truth_topic
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import problem_of


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
