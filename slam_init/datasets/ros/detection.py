"""Recognizes ROS bags by their content."""

from __future__ import annotations

import os
from pathlib import Path

from slam_init.errors import SourceError
from slam_init.system.regular_file import open_regular

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
