"""Recognizes ROS bags, and reads their messages one after the other, through ``rosbags``.

What the library raises on a broken bag is of many types. Each becomes a :class:`~slam_init.errors.SourceError`.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam_init.errors import SourceError, plain_line
from slam_init.system.regular_file import check_inside, first_bytes, kind_problem

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: The file that describes a ROS 2 bag.
METADATA = "metadata.yaml"
#: The files that hold the messages of a ROS 2 bag.
STORAGE_SUFFIXES = (".db3", ".mcap")

_METADATA_KEY = b"rosbag2_bagfile_information"
_METADATA_START = 4096
#: How the files start.
ROS1, MCAP = b"#ROSBAG V", b"\x89MCAP0\r\n"
_LONGEST_CAUSE = 200
_HINTS = {
    "not indexed": "the recording was not finished: run `rosbag reindex` on it",
    "damaged": "it is cut off: copy it again, or run `rosbag reindex` on it",
    "magic is invalid": "it is no bag, or it is cut off: copy it again, or run `mcap recover`",
    "unable to open database": "databases with ?, # or % in their path cannot be opened: rename the bag",
}


def is_bag_folder(folder: Path) -> bool:
    """Tell whether a folder is a ROS 2 bag."""
    metadata = folder / METADATA
    described = metadata.is_file() and _METADATA_KEY in first_bytes(metadata, _METADATA_START)
    return described or bool(_storage_files(folder))


def _storage_files(folder: Path) -> list[Path]:
    """The files in a folder that hold messages of ROS 2."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.lower().endswith(STORAGE_SUFFIXES)]
    return [folder / name for name in sorted(names) if not name.startswith(".")]


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str
    #: Message type in the spelling of ROS 2, for example ``sensor_msgs/msg/Image``.
    type: str
    #: Number of messages.
    count: int


@dataclass(frozen=True)
class Message:
    """A message of a standard type."""

    #: For error messages.
    place: str
    #: Time in seconds at which the recorder received it.
    received_s: float
    #: The decoded fields.
    content: Any

    @property
    def stamp_s(self) -> float:
        """Time stamp of its header in seconds; 0 where the sender has set none."""
        stamp = self.content.header.stamp
        return float(stamp.sec + stamp.nanosec * 1e-9)

    @property
    def frame_id(self) -> str:
        """Name of the coordinate frame. Old frames of ROS 1 start with a slash, and their transforms do not."""
        return str(self.content.header.frame_id).lstrip("/")


class Bag:
    """An open bag. It is a context manager that closes itself.

    * ``path``: A file (``.bag``, ``.db3``, ``.mcap``) or the folder of a ROS 2 bag.
    * ``version``: 1 or 2, of ROS.
    * ``topics``: Sorted by name.
    """

    def __init__(self, path: Path) -> None:
        # A broken file with the suffix of a bag is one.
        is_ros1 = path.is_file() and (path.suffix.lower() == ".bag" or first_bytes(path, len(ROS1)) == ROS1)
        self.path, self.version = path, 1 if is_ros1 else 2
        try:
            from rosbags import rosbag1, rosbag2

            types = _standard_types(self.version)
        except ImportError:
            raise SourceError(f'{self.path}: reading ROS bags needs rosbags: pip install ".[ros]"') from None
        self._decode = types.deserialize_ros1 if self.version == 1 else types.deserialize_cdr
        file = self._checked_file()
        try:
            self._reader: Any = rosbag1.Reader(file) if self.version == 1 else rosbag2.Reader(file)
            self._reader.open()
            topics = sorted(self._reader.topics.items())
        except Exception as error:
            raise self._broken(error, f"{self.path}") from None
        self.topics = tuple(Topic(name, info.msgtype or "", info.msgcount) for name, info in topics)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            self._reader.close()

    def messages(self, topic: Topic) -> Iterator[Message]:
        """Read the messages of a topic in the order in which they were recorded."""
        connections = [connection for connection in self._reader.connections if connection.topic == topic.name]
        messages = self._reader.messages(connections=connections)
        for number in itertools.count():
            place = f"{self.path}: {topic.name}, message {number}"
            try:
                _, received_ns, data = next(messages)
                content = self._decode(data, topic.type)
            except StopIteration:
                return
            except Exception as error:
                raise self._broken(error, place) from None
            yield Message(place, received_ns / 1e9, content)

    def first(self, topic: Topic) -> Message:
        """Read the first message of a topic."""
        for message in self.messages(topic):
            return message
        raise SourceError(f"{self.path}: {topic.name} holds no message: the index of the bag is wrong")

    def _checked_file(self) -> Path:
        """What the library is to open: the folder of a bag with metadata, else the file of the messages."""
        if not self.path.is_dir():
            return self.path
        files = _storage_files(self.path)
        described = (self.path / METADATA).exists()
        for path in (*files, *[self.path / METADATA] * described):
            check_inside(path, self.path)
            if problem := kind_problem(path):
                raise SourceError(f"{path}: {problem}")
        if not described and len(files) != 1:
            raise SourceError(f"{self.path}: {len(files)} bags and no {METADATA}: give one of the files")
        return self.path if described else files[0]

    def _broken(self, error: Exception, place: str) -> SourceError:
        """The error of a broken bag, in one line."""
        cause = " ".join(str(error).split()) or type(error).__name__
        hint = next((hint for words, hint in _HINTS.items() if words in cause), "the bag is broken: record it again")
        return SourceError(f"{place}: cannot be read ({plain_line(cause[:_LONGEST_CAUSE])}): {hint}")


@cache
def _standard_types(version: int) -> Typestore:
    """The standard message types of a version of ROS; to load them takes 0.1 s."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if version == 2:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    definition = "geometry_msgs/TransformStamped[] transforms"  # rosbags has no tf2_msgs for ROS 1
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        types.register(get_types_from_msg(definition, name))
    return types
