"""TUM RGB-D folders, ICL-NUIM in its TUM-compatible form, and ETH3D SLAM.

A folder holds:

* ``rgb.txt`` (``timestamp filename``), or ``associations.txt`` (``timestamp filename timestamp filename``, colour and
  depth in either order);
* ``groundtruth.txt`` (``timestamp tx ty tz qx qy qz qw``, world_from_cam), optional;
* ``camera.yaml``, the calibration, optional; or ``calibration.txt`` of ETH3D SLAM: ``fx fy cx cy``, where the centre of
  the first pixel is at 0. Without them the published calibrations are used: for ICL-NUIM, and for TUM
  RGB-D where the name of the folder holds ``freiburg1``, ``freiburg2`` or ``freiburg3``.

ICL-NUIM is rendered in a frame whose y axis points up, which its authors write as a negative focal length ``fy``. Its
TUM-compatible images are stored from top to bottom like all others. Therefore the camera has ``fy = +480`` here, and
the poses of ``*.gt.freiburg`` are reflected: with ``F = diag(1, -1, 1)``, ``R <- F R F``, ``t <- F t``. The first
column of its files is a frame number, which is converted to seconds at the published 30 Hz.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import MAX_FRAMES, ImageFileSource, read_image, stored_camera
from slam_init.datasets.stamps import image_times, stamp_of, truth_on_clock
from slam_init.datasets.text import numbers, read_rows, read_tum_trajectory
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose, Trajectory

#: Files that list the images; the first that exists is read.
INDEX_FILES = ("rgb.txt", "associations.txt", "associated.txt")

# Published with the data sets: the colour cameras of the three Kinects of TUM RGB-D (the images of the third one are
# already undistorted), and the renderer of ICL-NUIM.
_FREIBURG = {
    "1": Camera(
        "radtan",
        640,
        480,
        517.306408,
        516.469215,
        318.64304,
        255.313989,
        (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    "2": Camera(
        "radtan",
        640,
        480,
        520.908620,
        521.007327,
        325.141442,
        249.701764,
        (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    "3": Camera("pinhole", 640, 480, 535.4, 539.2, 320.1, 247.6),
}
_ICL_NUIM = Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
_ICL_NUIM_RATE_HZ = 30.0


def open_tum(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a TUM RGB-D or ICL-NUIM folder."""
    folder = Path(folder)
    icl_truths = sorted(folder.glob("*.gt.freiburg"))
    if len(icl_truths) > 1:
        raise SourceError(f"{folder}: several *.gt.freiburg: keep the one that belongs to the images")
    unit_s = 1 / _ICL_NUIM_RATE_HZ if icl_truths else 1.0
    paths, stamps, places = _read_index(folder)
    notes: tuple[str, ...] = ()
    if icl_truths:  # frame numbers
        timestamps_s, _ = image_times((np.array(stamps) * unit_s).tolist(), places)
    else:
        timestamps_s, notes = image_times(stamps, places)
    camera = stored_camera(folder, paths[0]) or _eth3d_camera(folder, paths[0])
    truth: Trajectory | None = None
    if icl_truths:
        camera = camera or _ICL_NUIM
        truth = _reflected(read_tum_trajectory(icl_truths[0], folder), unit_s)
    else:
        named = re.search(r"freiburg([123])", folder.resolve().name)
        camera = camera or (_FREIBURG[named[1]] if named else None)
        if (folder / "groundtruth.txt").exists():
            raw_truth = read_tum_trajectory(folder / "groundtruth.txt", folder)
            truth, truth_notes = truth_on_clock(raw_truth, timestamps_s)
            notes = (*notes, *truth_notes)
    return ImageFileSource(folder.resolve().name, "tum", paths, timestamps_s, camera, truth, notes, folder)


def _eth3d_camera(folder: Path, first_image: Path) -> Camera | None:
    """The camera of ``calibration.txt``; None if there is no such file."""
    path = folder / "calibration.txt"
    if not path.is_file():
        return None
    row = next(read_rows(path, folder), None)
    if row is None:
        raise SourceError(f"{path}: is empty: expected fx fy cx cy")
    fx, fy, cx, cy = numbers(row, row[1].split(), 4, "fx fy cx cy")
    height, width = read_image(first_image, folder).shape[:2]
    try:
        return Camera("pinhole", width, height, fx, fy, cx, cy)
    except CalibrationError as error:
        raise CalibrationError(f"{row[0]}: {error}") from None


def _read_index(folder: Path) -> tuple[tuple[Path, ...], list[float], list[str]]:
    """Paths and time stamps of the images that the folder lists, and for each the place of its line."""
    index = next((folder / name for name in INDEX_FILES if (folder / name).is_file()), None)
    if index is None:
        raise SourceError(f"{folder}: holds none of {', '.join(INDEX_FILES)}")
    paths: list[Path] = []
    stamps: list[float] = []
    places: list[str] = []
    for row in read_rows(index, folder):
        place, text = row
        if index.name == "rgb.txt":
            fields = text.split(maxsplit=1)  # a file name may hold spaces
        else:
            fields = text.split()
            if len(fields) >= 4 and fields[1].lower().startswith("depth"):
                fields = fields[2:]
        stamps.append(stamp_of(row, fields, "a timestamp and a file name"))
        if len(fields) < 2:
            raise SourceError(f"{place}: expected a timestamp and a file name, found {text[:60]!r}")
        paths.append(folder / fields[1])
        places.append(place)
        if len(paths) > MAX_FRAMES:
            raise SourceError(f"{index}: lists more than {MAX_FRAMES} images: split the sequence")
    if not paths:
        raise SourceError(f"{index}: lists no image")
    return tuple(paths), stamps, places


def _reflected(truth: Trajectory | None, unit_s: float) -> Trajectory | None:
    """The poses of ICL-NUIM for world and camera frames whose y axes point down."""
    if truth is None:
        return None
    F = np.diag([1.0, -1.0, 1.0])
    poses = tuple(Pose(F @ pose.R @ F, F @ pose.t) for pose in truth.world_from_cam)
    return Trajectory(truth.timestamps_s * unit_s, poses)
