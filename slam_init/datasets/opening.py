"""Opens the source that the user names. This module is the only one that detects the kind of a source.

The kinds of folders and files are tables. The first entry that fits is taken, so that an entry that looks for special
files stands before one that looks for common ones.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slam_init.datasets.arkit import (
    find_arkitscenes,
    find_record3d,
    is_stray_scanner,
    open_arkitscenes,
    open_record3d,
    open_stray_scanner,
)
from slam_init.datasets.colmap import find_colmap_model, open_colmap
from slam_init.datasets.colmap_database import is_colmap_database, open_colmap_database
from slam_init.datasets.euroc import find_euroc_camera, open_euroc
from slam_init.datasets.folder import open_folder
from slam_init.datasets.fourseasons import find_fourseasons_images, open_fourseasons
from slam_init.datasets.hloc import is_hdf5, open_hloc
from slam_init.datasets.hololens import find_hololens_index, open_hololens
from slam_init.datasets.image_files import IMAGE_SUFFIXES, holds_image
from slam_init.datasets.kitti import find_kitti_images, open_kitti
from slam_init.datasets.kitti360 import find_kitti360_images, open_kitti360
from slam_init.datasets.live import is_live
from slam_init.datasets.live.address import without_password
from slam_init.datasets.nerf import LLFF_FILE, TRANSFORMS, open_llff, open_transforms
from slam_init.datasets.ros import BagName, detect_file, is_bag_folder, open_ros
from slam_init.datasets.synth import PREFIX, open_synth
from slam_init.datasets.tartanair import find_tartanair, open_tartanair
from slam_init.datasets.timed import TimedSource
from slam_init.datasets.tracks_file import is_tracks_file, open_tracks_file
from slam_init.datasets.trakmark import find_trakmark_extrinsics, open_trakmark
from slam_init.datasets.tum import INDEX_FILES, open_tum
from slam_init.datasets.user import PYTHON, open_python
from slam_init.datasets.uzh_fpv import UZH_FPV_INDEX, open_uzh_fpv
from slam_init.datasets.video import open_video
from slam_init.errors import SourceError
from slam_init.system.regular_file import kind_problem, user_path


@dataclass(frozen=True)
class _Layout:
    """A kind of folder or file."""

    #: What :func:`detect_kind` returns.
    kind: str
    #: The files that tell it, and its name in brackets, for the message where nothing fits.
    looked_for: str
    #: Whether a path is of this kind: truthy if so. It reads no large file.
    fits: Callable[[Path], object]
    #: Opens a path of this kind.
    open: Callable[[Path], TimedSource]


def _any_of(*names: str) -> Callable[[Path], bool]:
    """Make a test whether a folder holds one of these files."""
    return lambda folder: any((folder / name).is_file() for name in names)


def _holds_images(folder: Path) -> bool:
    return holds_image(folder) or ((folder / "images").is_dir() and holds_image(folder / "images"))


_FOLDERS: tuple[_Layout, ...] = (
    _Layout("tum", f"{', '.join(INDEX_FILES)} (TUM)", _any_of(*INDEX_FILES), open_tum),
    _Layout("euroc", "mav0/cam0/data.csv (EuRoC)", find_euroc_camera, open_euroc),
    _Layout("kitti360", "image_00/data_rect (KITTI-360)", find_kitti360_images, open_kitti360),
    _Layout("kitti", "image_0 or image_2 (KITTI)", find_kitti_images, open_kitti),
    _Layout("tartanair", "image_left with pose_left.txt (TartanAir)", find_tartanair, open_tartanair),
    _Layout("4seasons", "undistorted_images/cam0 (4Seasons)", find_fourseasons_images, open_fourseasons),
    _Layout("uzh-fpv", f"{UZH_FPV_INDEX} (UZH-FPV)", _any_of(UZH_FPV_INDEX), open_uzh_fpv),
    _Layout("hololens", "PV with NAME_pv.txt (HoloLens 2)", find_hololens_index, open_hololens),
    _Layout("arkitscenes", "lowres_wide.traj (ARKitScenes)", find_arkitscenes, open_arkitscenes),
    _Layout("record3d", "metadata.json with rgb (Record3D)", find_record3d, open_record3d),
    _Layout(
        "stray-scanner", "odometry.csv with camera_matrix.csv (Stray Scanner)", is_stray_scanner, open_stray_scanner
    ),
    _Layout("transforms", f"{TRANSFORMS[0]} (nerfstudio, instant-ngp)", _any_of(*TRANSFORMS), open_transforms),
    _Layout("colmap", "cameras and images, .txt or .bin, perhaps in sparse/0 (COLMAP)", find_colmap_model, open_colmap),
    _Layout("llff", f"{LLFF_FILE} (LLFF)", _any_of(LLFF_FILE), open_llff),
    _Layout("trakmark", "a table *extrinsic* (TrakMark)", find_trakmark_extrinsics, open_trakmark),
    _Layout("ros2", "metadata.yaml, .mcap or .db3 (ROS 2)", is_bag_folder, lambda path: open_ros(path, 2)),
    _Layout("images", "images in it or in images/", _holds_images, open_folder),
)

_FILES: tuple[_Layout, ...] = (
    _Layout("colmap-database", "a database of COLMAP", is_colmap_database, open_colmap_database),
    _Layout("hloc", "matches of hloc (.h5)", is_hdf5, open_hloc),
    _Layout("tracks", "tracks (.npz)", is_tracks_file, open_tracks_file),
    _Layout("ros1", "a ROS 1 bag", lambda path: detect_file(path) == "ros1", lambda path: open_ros(path, 1)),
    _Layout("ros2", "a ROS 2 bag", lambda path: detect_file(path) == "ros2", lambda path: open_ros(path, 2)),
    _Layout("video", "a video", lambda _: True, open_video),
)


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
    text = os.fspath(text)
    if text.startswith(PREFIX):
        return open_synth(text, seed)
    if text.startswith(PYTHON):
        return open_python(text)
    layout, bag = _layout_of(text), BagName.parse(text)
    path = user_path(bag.path if bag else text)
    try:
        if bag:
            return open_ros(path, 1 if layout.kind == "ros1" else 2, bag.topic, bag.truth_topic)
        return layout.open(path)
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def detect_kind(text: str | os.PathLike[str]) -> str:
    """Detect the kind of a source."""
    text = os.fspath(text)
    if text.startswith(PREFIX):
        return "synth"
    if text.startswith(PYTHON):
        return "python"
    return _layout_of(text).kind


def _layout_of(text: str) -> _Layout:
    """The first layout that fits a path."""
    if is_live(text):
        raise SourceError(f"{without_password(text)!r}: is a live source: it can only be run (slam-init run)")
    bag = BagName.parse(text)
    if bag:
        layout = _layout_of(bag.path)
        if not layout.kind.startswith("ros"):
            raise SourceError(f"{bag.path}: is no ROS bag, so that it has no topics")
        return layout
    path = user_path(text)
    try:
        if path.is_dir():
            return _first_that_fits(path)
        if path.is_file():
            if path.suffix.lower() in IMAGE_SUFFIXES:
                raise SourceError(f"{path}: one image is not a sequence: give the folder {path.parent}")
            return next(layout for layout in _FILES if layout.fits(path))
        missing = not path.exists()
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        if isinstance(error, SourceError):
            raise
        cause = getattr(error, "strerror", None) or error
        raise SourceError(f"{text!r}: cannot be read ({cause})") from None
    if missing:
        raise SourceError(f"{text!r}: no such file or folder; give one, or synth:NAME")
    raise SourceError(f"{path} {kind_problem(path)}")


def _first_that_fits(folder: Path) -> _Layout:
    for layout in _FOLDERS:
        if layout.fits(folder):
            return layout
    looked_for = ", ".join(layout.looked_for for layout in _FOLDERS)
    raise SourceError(f"{folder}: no sequence in this folder; looked for {looked_for}")
