"""Chooses the topics of a bag: the images, their calibration, and the true poses."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

from slam_init.datasets.ros.bag import Bag, Topic
from slam_init.datasets.ros.messages import COMPRESSED, RAW, is_picture
from slam_init.errors import SourceError
from slam_init.system.regular_file import user_path

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

_QUERY = "?"


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
        path, mark, query = text.rpartition(_QUERY)
        options = dict(parse_qsl(query))
        is_path = os.path.exists(user_path(text))  # noqa: PTH110 (a Path raises for a null byte)
        if not mark or not options or set(options) - {"topic", "truth_topic"} or is_path:
            return None
        return BagName(path, options.get("topic"), options.get("truth_topic"))

    def __str__(self) -> str:
        options = {"topic": self.topic, "truth_topic": self.truth_topic}
        query = urlencode({key: value for key, value in options.items() if value is not None}, safe="/")
        return f"{self.path}{_QUERY}{query}" if query else self.path


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
