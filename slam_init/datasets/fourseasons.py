"""4Seasons recordings.

* ``undistorted_images/cam0`` (or ``distorted_images/cam0``) holds images whose names are nanoseconds.
* ``calibration/undistorted_calib_0.txt`` (``calib_0.txt``), in the folder of the recording or beside it: a line
  ``Pinhole`` or ``Equidistant`` with ``fx fy cx cy`` and four coefficients, and a line with width and height.
* ``GNSSPoses.txt``, the poses of the keyframes after the fusion with satellite positions:
  ``nanoseconds,tx,ty,tz,qx,qy,qz,qw,scale,...``. Where it is missing, ``result.txt``: the visual-inertial odometry of
  all frames in the format of TUM RGB-D. Both are world_from_cam with the axes of this project.
"""

from __future__ import annotations

import os
from pathlib import Path

from slam_init.datasets.image_files import ImageFileSource, list_images, stored_camera
from slam_init.datasets.stamps import image_times, stamp_of, truth_on_clock
from slam_init.datasets.text import numbers, pose_from_quaternion, read_rows, read_tum_trajectory, trajectory
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.camera import Camera
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import TimeUnit

_IMAGES = {"undistorted_images/cam0": "undistorted_calib_0.txt", "distorted_images/cam0": "calib_0.txt"}
_MODELS = {"Pinhole": "pinhole", "Equidistant": "fisheye"}
_CALIBRATIONS = ("calibration", "Calibration")


def find_fourseasons_images(folder: str | os.PathLike[str]) -> Path | None:
    """Find the images of the left camera."""
    return next((Path(folder) / name for name in _IMAGES if (Path(folder) / name).is_dir()), None)


def open_fourseasons(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a 4Seasons recording."""
    folder = Path(folder)
    images = find_fourseasons_images(folder)
    if images is None:
        raise SourceError(f"{folder}: holds no undistorted_images/cam0")
    paths = list_images(images)
    if not paths:
        raise SourceError(f"{images}: holds no image")
    rows = [(str(path), path.stem) for path in paths]
    stamps = [stamp_of(row, [row[1]], "a name in nanoseconds") for row in rows]
    timestamps_s, notes = image_times(stamps, [place for place, _ in rows], TimeUnit.NANOSECONDS)
    name = _IMAGES[images.relative_to(folder).as_posix()]
    homes = (folder, folder.resolve().parent)
    found = ((home, home / part / name) for home in homes for part in _CALIBRATIONS)
    home, path = next(((home, path) for home, path in found if path.is_file()), (folder, None))
    camera = stored_camera(folder, paths[0]) or (None if path is None else _read_camera(path, home))
    raw_truth, unit = _read_truth(folder)
    truth, truth_notes = truth_on_clock(raw_truth, timestamps_s, unit)
    return ImageFileSource(
        folder.resolve().name, "4seasons", tuple(paths), timestamps_s, camera, truth, (*notes, *truth_notes), folder
    )


def _read_camera(path: Path, root: Path) -> Camera:
    rows = list(read_rows(path, root))
    if len(rows) < 2:
        raise CalibrationError(f"{path}: expected a line of the lens and one of the image size")
    fields = rows[0][1].split()
    if fields[0] not in _MODELS:
        raise CalibrationError(f"{rows[0][0]}: the lens is {fields[0][:40]!r}: expected {' or '.join(_MODELS)}")
    fx, fy, cx, cy, *distortion = numbers(rows[0], fields[1:], 8, "fx fy cx cy and four coefficients")
    width, height = numbers(rows[1], rows[1][1].split(), 2, "width and height")
    model = _MODELS[fields[0]]
    try:
        return Camera(model, int(width), int(height), fx, fy, cx, cy, tuple(distortion) if model == "fisheye" else ())
    except CalibrationError as error:
        raise CalibrationError(f"{rows[0][0]}: {error}") from None


def _read_truth(folder: Path) -> tuple[Trajectory | None, TimeUnit]:
    """The poses as they stand in the file, and the unit of their stamps."""
    path = folder / "GNSSPoses.txt"
    if path.is_file():
        stamped = []
        for row in read_rows(path, folder):
            fields = [field.strip() for field in row[1].split(",")]
            stamp = stamp_of(row, fields, "a timestamp in nanoseconds")
            tx, ty, tz, qx, qy, qz, qw = numbers(row, fields[1:], 7, "timestamp,tx,ty,tz,qx,qy,qz,qw")
            stamped.append((stamp, pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz])))
        return trajectory(stamped), TimeUnit.NANOSECONDS
    path = folder / "result.txt"
    return (read_tum_trajectory(path, folder) if path.is_file() else None), TimeUnit.SECONDS
