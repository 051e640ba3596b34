"""Recognizes ROS bags, and reads their messages one after the other, through ``rosbags``.

What the library raises on a broken bag is of many types. Each becomes a :class:`~slam_init.errors.SourceError`.
"""

from __future__ import annotations

import bz2
import os
import re
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.datasets.image_files import MAX_PIXELS
from slam_init.errors import SourceError, plain_line
from slam_init.system.regular_file import check_inside, kind_problem, open_regular, read_regular

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys.store import Typestore

#: The file that describes a ROS 2 bag.
METADATA = "metadata.yaml"
#: The files that hold the messages of a ROS 2 bag.
STORAGE_SUFFIXES = (".db3", ".mcap")

_METADATA_KEY = b"rosbag2_bagfile_information"
_METADATA_START = 4096
_MAGIC_ROS1, _MAGIC_MCAP, _MAGIC_SQLITE = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0"


def detect_file(path: str | os.PathLike[str]) -> str | None:
    """Tell whether a file is a ROS bag.

    * Returns: ``ros1`` or ``ros2``; None if it is none. A broken file with the suffix of a bag is one.
    """
    path = Path(path)
    with open_regular(path, SourceError) as file:
        start = file.read(len(_MAGIC_SQLITE))
    if path.suffix.lower() == ".bag" or start.startswith(_MAGIC_ROS1):
        return "ros1"
    # Many programs write SQLite files, so that the suffix decides.
    if path.suffix.lower() in STORAGE_SUFFIXES or start.startswith(_MAGIC_MCAP):
        return "ros2"
    return None


def is_bag_folder(folder: str | os.PathLike[str]) -> bool:
    """Tell whether a folder is a ROS 2 bag."""
    metadata = Path(folder) / METADATA
    if metadata.is_file():
        with open_regular(metadata, SourceError) as file:
            if _METADATA_KEY in file.read(_METADATA_START):
                return True
    return bool(storage_files(folder))


def storage_files(folder: str | os.PathLike[str]) -> list[Path]:
    """List the files in a folder that hold messages of ROS 2."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.lower().endswith(STORAGE_SUFFIXES)]
    return [Path(folder, name) for name in sorted(names) if not name.startswith(".")]


#: Largest chunk or message when it is decompressed: a message holds one image of MAX_PIXELS with 8 bytes a pixel.
MAX_CHUNK_BYTES = 8 * MAX_PIXELS
# The metadata list each topic and each file. A bag that is split into 10,000 files has 2 MB.
_MAX_METADATA_BYTES = 4_000_000
_LONGEST_CAUSE = 200
# Metadata have six levels. Each level takes a bracket, or a character at the start of the line.
_MAX_DEPTH = 100
_BRACKETS = {ord("["): 1, ord("{"): 1, ord("]"): -1, ord("}"): -1}
_DEEP_LINE = re.compile(rb"^[ ?:-]{%d}" % (2 * _MAX_DEPTH), re.MULTILINE)
# The address of a SQLite database would end at these characters, or be decoded.
_NOT_IN_SQLITE_NAMES = "?#%"
_INSTALL = 'reading ROS bags needs rosbags: pip install ".[ros]"'
_HINTS = {
    "not indexed": "the recording was not finished: run `rosbag reindex` on it",
    "damaged": "it is cut off: copy it again, or run `rosbag reindex` on it",
    "magic is invalid": "it is no bag, or it is cut off: copy it again, or run `mcap recover`",
}


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str
    #: Message type in the spelling of ROS 2, for example ``sensor_msgs/msg/Image``.
    type: str
    #: Number of messages.
    count: int


@dataclass(frozen=True)
class Header:
    """The header of a message."""

    #: Time stamp in seconds; 0 where the sender has set none.
    stamp_s: float
    #: Name of the coordinate frame.
    frame_id: str


@dataclass(frozen=True)
class Message:
    """A message that is not decoded."""

    #: Time in seconds at which the recorder received it.
    received_s: float
    data: bytes


class Bag:
    """An open bag. It is a context manager that closes itself.

    * ``path``: A file (``.bag``, ``.db3``, ``.mcap``) or the folder of a ROS 2 bag.
    * ``version``: 1 or 2, of ROS.
    * ``topics``: Sorted by name.
    """

    def __init__(self, path: str | os.PathLike[str], version: int) -> None:
        self.path, self._version = Path(path), version
        try:
            import rosbags  # noqa: F401

            self._types = _standard_types(version)
        except ImportError:
            raise SourceError(f"{self.path}: {_INSTALL}") from None
        self._compressed_messages = False
        self._reader: Reader1 | Reader2 = self._open1() if version == 1 else self._open2()
        self.topics = tuple(
            Topic(name, info.msgtype or "", info.msgcount) for name, info in sorted(self._reader.topics.items())
        )

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            self._reader.close()

    def messages(self, topic: str) -> Iterator[Message]:
        """Read the messages of a topic in the order in which they were recorded."""
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        messages = self._reader.messages(connections=connections)
        while True:
            try:
                _, received_ns, data = next(messages)
                if self._compressed_messages:
                    data = _unpacked(_zstd(), data, MAX_CHUNK_BYTES)
            except StopIteration:
                return
            except SourceError:
                raise
            except Exception as error:
                raise self._broken(error, f"topic {topic}") from None
            yield Message(received_ns / 1e9, bytes(data))

    def first(self, topic: str) -> Message | None:
        """Read the first message of a topic."""
        return next(self.messages(topic), None)

    def decoded(self, message: Message, topic: Topic) -> Any:
        """Decode a message of a standard type."""
        decode = self._types.deserialize_ros1 if self._version == 1 else self._types.deserialize_cdr
        try:
            return decode(message.data, topic.type)
        except Exception as error:
            raise self._broken(error, f"a message of {topic.name}") from None

    def header_of(self, message: Message, topic: Topic) -> Header:
        """Read the header of a message whose first field it is, without decoding the rest."""
        data = message.data
        try:
            if self._version == 1:  # the first number is a counter
                _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
                text = data[16 : 16 + length]
            else:  # the second byte tells the byte order; strings end with a zero
                order = "<" if data[1] & 1 else ">"
                seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
                text = data[16 : 16 + max(length, 1) - 1]
            # Old frames of ROS 1 start with a slash, and their transforms do not.
            return Header(seconds + nanoseconds * 1e-9, text.decode("utf-8", "replace").lstrip("/"))
        except (struct.error, IndexError) as error:
            raise self._broken(error, f"a message of {topic.name}") from None

    # -- opening ----------------------------------------------------------------------------------

    def _open1(self) -> Reader1:
        from rosbags.rosbag1 import Reader

        self._check_file(self.path)
        reader: Reader1 = self._opened(Reader)
        for position, chunk in reader.chunks.items():
            reader.chunks[position] = chunk._replace(decompressor=_bounded_ros1(chunk.decompressor))
        return reader

    def _open2(self) -> Reader2:
        from rosbags.rosbag2 import Reader, storage_mcap

        if self.path.is_dir():
            self._check_folder()
        else:
            self._check_file(self.path)
        # The library decompresses without a bound. Its table of methods is replaced by methods with one.
        lz4, zstd = _lz4(), _zstd()
        storage_mcap.DECOMPRESSORS.update(
            lz4=lambda data, size: _unpacked(lz4, data, size), zstd=lambda data, size: _unpacked(zstd, data, size)
        )
        reader: Reader2 = self._opened(Reader)
        metadata = reader.storage.metadata
        if metadata.compression_mode == "message":  # decompressed here, within the bound
            reader.storage.metadata = metadata._replace(compression_mode=None)
            self._compressed_messages = True
        return reader

    def _opened(self, make: Callable[[Path], Any]) -> Any:
        """Open a reader of the library."""
        path = self.path
        if path.is_dir() and not (path / METADATA).is_file():
            (path,) = storage_files(path)
        try:
            reader = make(path)
            reader.open()
            _ = reader.topics
        except OSError as error:
            raise SourceError(f"{self.path}: cannot be read ({error.strerror or error})") from None
        except Exception as error:
            raise self._broken(error) from None
        return reader

    def _check_file(self, path: Path) -> None:
        if problem := kind_problem(path):
            raise SourceError(f"{path}: {problem}")
        if path.suffix == ".db3" and any(character in str(path.resolve()) for character in _NOT_IN_SQLITE_NAMES):
            raise SourceError(f"{path}: rename the bag: databases with ?, # or % in their path cannot be opened")
        if not path.stat().st_size:
            raise SourceError(f"{path}: the bag is empty")

    def _check_folder(self) -> None:
        """Check the files of a folder before the library opens them."""
        text = b""
        if (self.path / METADATA).exists():
            check_inside(self.path / METADATA, self.path)
            text = read_regular(self.path / METADATA, _MAX_METADATA_BYTES, "the metadata of a bag", SourceError)
            _check_nesting(self.path / METADATA, text)
            if b"compression_mode: FILE" in text.replace(b'"', b"") or b"compression_mode: file" in text:
                raise SourceError(
                    f"{self.path}: the files of this bag are compressed as a whole: decompress one "
                    f"(`unzstd FILE`), and give the {' or '.join(STORAGE_SUFFIXES)} file"
                )
        elif len(files := storage_files(self.path)) != 1:
            raise SourceError(f"{self.path}: {len(files)} bags and no {METADATA}: give one of the files")
        with os.scandir(self.path) as entries:
            named = [entry.name for entry in entries if entry.name.encode("utf-8", "replace") in text]
        for path in {*storage_files(self.path), *(self.path / name for name in named)}:
            check_inside(path, self.path)
            self._check_file(path)

    def _broken(self, error: Exception, where: str = "") -> SourceError:
        """The error of a broken bag, in one line."""
        cause = " ".join(str(error).split()) or type(error).__name__
        hint = next((hint for words, hint in _HINTS.items() if words in cause), "the bag is broken: record it again")
        place = f"{self.path}: {where}" if where else f"{self.path}"
        return SourceError(f"{place}: cannot be read ({plain_line(cause[:_LONGEST_CAUSE])}): {hint}")


def _check_nesting(path: Path, text: bytes) -> None:
    """Refuse metadata that are nested deeply, since the time of the YAML reader grows with the square of the depth."""
    depth = np.cumsum([_BRACKETS.get(character, 0) for character in text])
    if depth.max(initial=0) > _MAX_DEPTH or _DEEP_LINE.search(text):
        raise SourceError(f"{path}: cannot be read: nested deeper than {_MAX_DEPTH} levels")


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


def _unpacked(make: Callable[[], Any], data: bytes, limit: int) -> bytes:
    """Decompress data to no more than a number of bytes; bz2, lz4 and zstd have the same interface."""
    decompressor = make()
    limit = min(limit, MAX_CHUNK_BYTES)
    unpacked: bytes = decompressor.decompress(data, max_length=limit + 1)
    if len(unpacked) > limit:
        raise SourceError(f"a compressed part of the bag has more than {limit} bytes: it is broken, or hostile")
    if not decompressor.eof:
        raise ValueError("compressed data are cut off")
    return unpacked


def _bounded_ros1(decompress: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """The method of a chunk of ROS 1, with a bound."""
    from rosbags.rosbag1 import reader

    methods: dict[Callable[[bytes], bytes], Callable[[], Any]] = {
        reader.decompressors["bz2"]: bz2.BZ2Decompressor,
        reader.decompressors["lz4"]: _lz4(),
    }
    make = methods.get(decompress)
    return decompress if make is None else lambda data: _unpacked(make, data, MAX_CHUNK_BYTES)


def _lz4() -> Callable[[], Any]:
    from lz4.frame import LZ4FrameDecompressor

    decompressor: Callable[[], Any] = LZ4FrameDecompressor
    return decompressor


def _zstd() -> Callable[[], Any]:
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdDecompressor
    else:
        from backports.zstd import ZstdDecompressor
    return ZstdDecompressor
