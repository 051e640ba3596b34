"""Opens the source that the user names. This module is the only one that detects the kind of a source.

The kinds of folders and files are tables. The first entry that fits is taken, so that an entry that looks for special
files stands before one that looks for common ones. Other packages announce their layouts by entry points
``slam_init.readers``, which are asked first. A data set of the user, ``python:package.module:attribute``, is a function
of no arguments (``docs/examples/add_a_data_set.py`` has both).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.datasets.colmap import SQLITE, open_colmap_database
from slam_init.datasets.hloc import HDF5, open_hloc
from slam_init.datasets.image_files import IMAGE_SUFFIXES, image_folder, natural_key, open_folder
from slam_init.datasets.layouts import LAYOUTS
from slam_init.datasets.live import is_live, without_password
from slam_init.datasets.posed_images import Layout
from slam_init.datasets.ros.bag import MCAP, ROS1, STORAGE_SUFFIXES, is_bag_folder
from slam_init.datasets.ros.source import BagName, RosSource
from slam_init.datasets.synth import PREFIX, open_synth
from slam_init.datasets.text import image_times
from slam_init.datasets.track_source import open_tracks_file
from slam_init.datasets.video import open_video
from slam_init.errors import SlamInitError, SourceError, check_type
from slam_init.system.regular_file import first_bytes, kind_problem, user_path
from slam_init.system.user_code import attribute_of, described_error
from slam_init.types.frame import TimedSource

#: Prefix of the name of such a source.
PYTHON = "python:"
_FORM = "give python:package.module:attribute or python:FILE.py:attribute"
#: Attributes of a :class:`slam_init.types.frame.TimedSource`.
_REQUIRED_ATTRIBUTES = ("name", "kind", "camera", "groundtruth", "timestamps_s", "frames", "__len__")


def open_python(text: str) -> TimedSource:
    """Open a source by importing an attribute of a module and calling it without arguments.

    What it states is checked: a time in seconds for each frame, and true poses.

    * ``text``: ``python:package.module:attribute`` or ``python:FILE.py:attribute``; the call returns a
      :class:`~slam_init.types.frame.TimedSource`.
    """
    try:
        source: TimedSource = attribute_of(text.removeprefix(PYTHON))()
    except SlamInitError:
        raise
    except (Exception, SystemExit) as error:  # a third-party module may raise anything
        raise SourceError(f"{text}: cannot be opened ({described_error(error)}): {_FORM}") from error
    if missing := [name for name in _REQUIRED_ATTRIBUTES if not hasattr(source, name)]:
        raise SourceError(f"{text}: the returned object is not a source: it has no {missing[0]}")
    try:
        stamps = np.asarray(source.timestamps_s, float)
        count = len(source)
    except (TypeError, ValueError):
        raise SourceError(f"{text}: timestamps_s is not an array of numbers: give one time for each frame") from None
    if stamps.shape != (count,) or count == 0:
        raise SourceError(f"{text}: timestamps_s has the shape {stamps.shape} for {count} frames: give one for each")
    for index, pose in enumerate(() if source.groundtruth is None else source.groundtruth.world_from_cam):
        if problem := pose.problem():
            raise SourceError(f"{text}: groundtruth: pose {index} {problem}")
    if image_times(stamps.tolist(), [f"{text}: frame {index}" for index in range(count)])[1]:
        raise SourceError(f"{text}: timestamps_s steps by {np.median(np.diff(stamps)):g}: give seconds")
    return source


_FOLDERS: tuple[Layout, ...] = (
    *LAYOUTS,
    Layout("ros2", "metadata.yaml, .mcap or .db3 (ROS 2)", is_bag_folder, lambda path, _: RosSource(path)),
    Layout("images", "images in it or in images/", image_folder, lambda path, _: open_folder(path)),
)


def _file(
    kind: str, looked_for: str, suffixes: tuple[str, ...], magic: bytes, open_: Callable[[Path], TimedSource]
) -> Layout:
    """A kind of file: by its suffix, or by the bytes with which it starts."""

    def fits(path: Path) -> bool:
        return path.suffix.lower() in suffixes or (bool(magic) and first_bytes(path, len(magic)) == magic)

    return Layout(kind, looked_for, fits, lambda path, _: open_(path))


# Many programs write SQLite files, so that the suffix marks those of ROS 2.
_FILES: tuple[Layout, ...] = (
    _file("hloc", "matches of hloc (.h5)", (".h5", ".hdf5"), HDF5, open_hloc),
    _file("tracks", "tracks (.npz)", (".npz",), b"", open_tracks_file),
    _file("ros1", "a ROS 1 bag", (".bag",), ROS1, RosSource),
    _file("ros2", "a ROS 2 bag", STORAGE_SUFFIXES, MCAP, RosSource),
    _file("colmap-database", "a database of COLMAP", (".db",), SQLITE, open_colmap_database),
    # The last one: any other file is tried as a video.
    Layout("video", "a video", lambda _: True, lambda path, _: open_video(path)),
)

_VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".mts", ".3gp"})
# Of a folder that is no sequence: how many of its entries are looked at, and how many of its sequences are named.
_LOOKED_AT, _NAMED = 1000, 3


def open_source(text: str | os.PathLike[str], seed: int = 0) -> TimedSource:
    """Open a folder, a file, ``synth:NAME`` or ``python:package.module:attribute``.

    Parameters
    ----------
    text : str or path-like
        A path, or the name of a source in one of the forms above. The path of a ROS bag may name topics:
        ``PATH?topic=/cam0/image_raw&truth_topic=/pose``.
    seed : int
        Seed of a synthetic sequence; ignored for other sources.

    Returns
    -------
    TimedSource

    Raises
    ------
    SourceError, CalibrationError
        If there is nothing to read, or if a file is broken. The message is one line that says what to do.
    """
    text = _text(text)
    if text.startswith(PREFIX):
        return open_synth(text, seed)
    if text.startswith(PYTHON):
        return open_python(text)
    (layout, found), bag = _layout_of(text), BagName.parse(text)
    path = user_path(bag.path if bag else text)
    try:
        if bag:
            return RosSource(path, bag.topic, bag.truth_topic)
        return layout.open(path, found)
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def detect_kind(text: str | os.PathLike[str]) -> str:
    """Detect the kind of a source."""
    text = _text(text)
    prefix, colon, _ = text.partition(":")
    return prefix if prefix + colon in (PREFIX, PYTHON) else _layout_of(text)[0].kind


def _text(source: str | os.PathLike[str]) -> str:
    check_type(source, (str, os.PathLike), "the source", "a path, or synth:NAME", SourceError)
    return os.fspath(source)


def _layout_of(text: str) -> tuple[Layout, Any]:
    """The first layout that fits a path, and what it found."""
    if is_live(text):
        raise SourceError(f"{without_password(text)!r}: is a live source: it can only be run (slam-init run)")
    if bag := BagName.parse(text):
        layout, found = _layout_of(bag.path)
        if not layout.kind.startswith("ros"):
            raise SourceError(f"{bag.path}: is no ROS bag, so that it has no topics")
        return layout, found
    path = user_path(text)
    try:
        if path.is_dir():
            return _first_that_fits(path, (*_announced(), *_FOLDERS))
        if path.is_file():
            if path.suffix.lower() in IMAGE_SUFFIXES:
                raise SourceError(f"{path}: one image is not a sequence: give the folder {path.parent}")
            return _first_that_fits(path, _FILES)
        if text.startswith("points:"):
            raise SourceError(f"{text!r}: has no images: it is for slam-init compare; here use synth:NAME")
        if not path.exists():
            raise SourceError(f"{text!r}: no such file or folder; give one, or synth:NAME")
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        cause = getattr(error, "strerror", None) or error
        raise SourceError(f"{text!r}: cannot be read ({cause})") from None
    raise SourceError(f"{path} {kind_problem(path)}")


def _announced() -> list[Layout]:
    """The layouts of other packages."""
    layouts = []
    for entry in entry_points(group="slam_init.readers"):
        try:
            layout = entry.load()
        except (Exception, SystemExit) as error:
            problem = f"the reader {entry.value} cannot be loaded ({described_error(error)})"
            raise SourceError(f"{problem}: correct or uninstall it") from error
        if not isinstance(layout, Layout):
            raise SourceError(f"the reader {entry.value} is no slam_init.datasets.posed_images.Layout: make it one")
        layouts.append(layout)
    return layouts


def _first_that_fits(path: Path, layouts: tuple[Layout, ...]) -> tuple[Layout, Any]:
    for layout in layouts:
        if found := layout.find(path):
            return layout, found
    if sources := _sources_in(path):
        more = f" and {len(sources) - _NAMED} more" if len(sources) > _NAMED else ""
        raise SourceError(f"{path}: is not one sequence: give one of those in it: {', '.join(sources[:_NAMED])}{more}")
    looked_for = ", ".join(layout.looked_for for layout in layouts)
    raise SourceError(f"{path}: no sequence in this folder; looked for {looked_for}")


def _sources_in(folder: Path) -> list[str]:
    """The folders and files of a folder that are sources, in the order of their names."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in itertools.islice(entries, _LOOKED_AT) if not entry.name.startswith(".")]
    return [name for name in sorted(names, key=natural_key) if _is_source(folder / name)]


def _is_source(path: Path) -> bool:
    if path.suffix.lower() in _VIDEO_SUFFIXES:
        return path.is_file()
    try:
        layouts = _FOLDERS if path.is_dir() else _FILES[:-1] if path.is_file() else ()  # any file may be a video
        return any(layout.find(path) for layout in layouts)
    except (OSError, SourceError):  # a folder that may not be read
        return False
