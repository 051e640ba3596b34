"""UZH-FPV sequences of the Snapdragon camera.

* ``left_images.txt`` lists ``id timestamp filename``.
* ``groundtruth.txt`` holds the poses world_from_body in the format of TUM RGB-D, of the inertial sensor.
* The calibration is published apart from the sequences, a camchain of Kalibr. It is looked for as ``camchain*.yaml`` in
  the folder, in a folder ``*calib*`` in it, or in one beside it. Its ``cam0`` is the left camera; ``T_cam_imu`` moves
  the true poses to the camera. Without it the true poses are not used, because they are those of another body.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from slam_init.calibration.files import load_camera, load_yaml
from slam_init.datasets.image_files import ImageFileSource, read_image, stored_camera
from slam_init.datasets.stamps import image_times, stamp_of, truth_on_clock
from slam_init.datasets.text import pose_from_matrix, read_rows, read_tum_trajectory
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.pose import Pose, Trajectory

#: The list of the images of the left camera.
UZH_FPV_INDEX = "left_images.txt"


def open_uzh_fpv(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a UZH-FPV sequence."""
    folder = Path(folder)
    paths: list[Path] = []
    stamps: list[float] = []
    places: list[str] = []
    for row in read_rows(folder / UZH_FPV_INDEX, folder):
        fields = row[1].split(maxsplit=2)
        if len(fields) < 3:
            raise SourceError(f"{row[0]}: expected id, timestamp and file name, found {row[1][:60]!r}")
        stamps.append(stamp_of(row, fields[1:], "id, timestamp and file name"))
        paths.append(folder / fields[2])
        places.append(row[0])
    if not paths:
        raise SourceError(f"{folder / UZH_FPV_INDEX}: lists no image")
    timestamps_s, notes = image_times(stamps, places)
    camera = stored_camera(folder, paths[0])
    truth: Trajectory | None = None
    chain = _find_chain(folder)
    truth_file = folder / "groundtruth.txt"
    if chain is None:
        if truth_file.is_file():
            notes = (*notes, "the ground truth is that of the inertial sensor: put the camchain.yaml into the folder")
    else:
        home, path = chain
        check_inside(path, home)
        height, width = read_image(paths[0], folder).shape[:2]
        camera = camera or load_camera(path, (width, height))
        if truth_file.is_file():
            of_body = read_tum_trajectory(truth_file, folder)
            truth, truth_notes = truth_on_clock(of_body, timestamps_s)
            notes = (*notes, *truth_notes)
            body_from_cam = _cam_from_body(path).inverse()
            if truth is not None:
                truth = Trajectory(truth.timestamps_s, tuple(pose @ body_from_cam for pose in truth.world_from_cam))
    return ImageFileSource(folder.resolve().name, "uzh-fpv", tuple(paths), timestamps_s, camera, truth, notes, folder)


def _find_chain(folder: Path) -> tuple[Path, Path] | None:
    """The calibration, and the folder that it must lie in."""
    beside = folder.resolve().parent
    for home, pattern in (
        (folder, "camchain*.yaml"),
        (folder, "*calib*/camchain*.yaml"),
        (beside, "*calib*/camchain*.yaml"),
    ):
        found = sorted(home.glob(pattern))
        if len(found) > 1:
            names = ", ".join(str(path.relative_to(home)) for path in found[:2])
            raise SourceError(f"{home}: several calibrations ({names}): keep the one that belongs to the images")
        if found:
            return home, found[0]
    return None


def _cam_from_body(path: Path) -> Pose:
    content = load_yaml(path)
    entry = content.get("cam0") if isinstance(content, dict) else None
    matrix = entry.get("T_cam_imu") if isinstance(entry, dict) else None
    try:
        values = np.array(matrix, float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != (4, 4):
        raise CalibrationError(f"{path}: cam0: T_cam_imu is not a matrix of 4x4 numbers")
    return pose_from_matrix(f"{path}: cam0: T_cam_imu", values)
