"""EuRoC MAV sequences (the ASL folder layout).

* ``mav0/cam0/data.csv`` lists ``timestamp [ns],filename``.
* ``mav0/cam0/sensor.yaml`` holds the calibration and ``T_BS`` (body_from_cam).
* ``mav0/imu0`` holds the rates of the gyroscope in ``data.csv`` (``timestamp [ns],w_x,w_y,w_z [rad/s],...``), its own
  ``T_BS`` (body_from_imu) and its noise density in ``sensor.yaml``. The folder is optional.
* ``mav0/state_groundtruth_estimate0/data.csv`` holds the poses world_from_body.

The true poses are ``world_from_cam = world_from_body @ body_from_cam``.
"""

from __future__ import annotations

import math
import os
from functools import partial
from pathlib import Path

import numpy as np

from slam_init.calibration.files import load_camera, load_yaml
from slam_init.datasets.gyroscope import Gyroscope, made_gyroscope
from slam_init.datasets.image_files import ImageFileSource, read_image
from slam_init.datasets.stamps import image_times, stamp_of, truth_on_clock
from slam_init.datasets.text import numbers, pose_from_matrix, pose_from_quaternion, read_rows, trajectory
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.time_stamps import TimeUnit, in_seconds, time_unit

_STAMP = "a timestamp in nanoseconds"


def find_euroc_camera(folder: str | os.PathLike[str]) -> Path | None:
    """Find the folder that holds the ``data.csv`` of the first camera."""
    folder = Path(folder)
    for candidate in (folder / "mav0" / "cam0", folder / "cam0", folder):
        if (candidate / "data.csv").is_file():
            return candidate
    return None


def open_euroc(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a EuRoC sequence."""
    found = find_euroc_camera(folder)
    if found is None:
        raise SourceError(f"{folder}: no cam0/data.csv in it")
    camera_folder = found.resolve()
    # The camera of a sequence has its ground truth beside it, so that the folder of the camera alone names its parent.
    root = camera_folder.parent if found == Path(folder) else Path(folder)
    paths: list[Path] = []
    stamps: list[float] = []
    places: list[str] = []
    for row in read_rows(camera_folder / "data.csv", root):
        fields = [field.strip() for field in row[1].split(",")]
        stamps.append(stamp_of(row, fields, _STAMP))
        if len(fields) < 2 or not fields[1]:
            raise SourceError(f"{row[0]}: expected timestamp,filename, found {row[1][:60]!r}")
        paths.append(camera_folder / "data" / fields[1])
        places.append(row[0])
    if not paths:
        raise SourceError(f"{camera_folder / 'data.csv'}: lists no image")
    timestamps_s, notes = image_times(stamps, places, TimeUnit.NANOSECONDS)
    sensor = camera_folder / "sensor.yaml"
    camera, body_from_cam = None, None
    if sensor.exists():
        check_inside(sensor, root)
        height, width = read_image(paths[0], root).shape[:2]
        camera = load_camera(sensor, (width, height))
        body_from_cam = _read_extrinsics(sensor)
    mav = camera_folder.parent
    truth_file = mav / "state_groundtruth_estimate0" / "data.csv"
    raw_truth = _read_truth(truth_file, root, body_from_cam or Pose.identity()) if truth_file.exists() else None
    truth, truth_notes = truth_on_clock(raw_truth, timestamps_s, TimeUnit.NANOSECONDS)
    imu, imu_notes = None, tuple[str, ...]()
    if (mav / "imu0" / "data.csv").exists():
        imu_sensor = mav / "imu0" / "sensor.yaml"
        if body_from_cam is not None and imu_sensor.exists():
            unit = time_unit(np.array(stamps), TimeUnit.NANOSECONDS)
            imu = partial(_read_gyroscope, mav / "imu0", root, body_from_cam, unit)
        else:
            imu_notes = ("imu0 is not used: no sensor.yaml tells its rotation against the camera (T_BS)",)
    name = mav.parent.name if mav.name == "mav0" else mav.name
    notes = (*notes, *truth_notes, *imu_notes)
    return ImageFileSource(name, "euroc", tuple(paths), timestamps_s, camera, truth, notes, root, imu)


def _read_gyroscope(folder: Path, root: Path, body_from_cam: Pose, unit: TimeUnit) -> Gyroscope:
    """The gyroscope in the axes of the camera; its stamps have the unit of those of the images."""
    sensor, table = folder / "sensor.yaml", folder / "data.csv"
    check_inside(sensor, root)
    body_from_imu = _read_extrinsics(sensor)
    if body_from_imu is None:
        raise SourceError(f"{sensor}: no T_BS, the pose of the gyroscope: add it, or leave --imu out")
    stamps: list[float] = []
    rates: list[list[float]] = []
    columns = 0
    for row in read_rows(table, root):
        fields = [field.strip() for field in row[1].split(",")]
        stamp = stamp_of(row, fields, _STAMP)
        if stamps and stamp <= stamps[-1]:
            raise SourceError(f"{row[0]}: time stamp {fields[0][:40]} does not come after the one before")
        columns = columns or len(fields)
        if len(fields) != columns:  # a line that is cut off may end in the middle of a number
            raise SourceError(f"{row[0]}: has {len(fields)} fields, the first line {columns}: copy it again")
        stamps.append(stamp)
        rates.append(numbers(row, fields[1:], 3, "timestamp,w_x,w_y,w_z (rad/s)"))
    if len(stamps) < 2:
        raise SourceError(f"{table}: holds less than two samples of the gyroscope: copy it again, or leave --imu out")
    return made_gyroscope(
        in_seconds(np.array(stamps), unit),
        np.array(rates),
        body_from_cam.R.T @ body_from_imu.R,
        noise_density=_read_noise_density(sensor),
        name="imu0",
    )


def _read_noise_density(sensor: Path) -> float | None:
    content = load_yaml(sensor)
    stated = content.get("gyroscope_noise_density") if isinstance(content, dict) else None
    if stated is None:
        return None
    try:
        density = float(stated)
    except (TypeError, ValueError):
        density = math.nan
    # From a fibre-optic gyroscope to the worst that is sold; in other units it would lie outside.
    if not 1e-8 <= density <= 0.1:
        raise SourceError(f"{sensor}: gyroscope_noise_density is {stated!r}: give rad/s/sqrt(Hz), as 1.7e-4")
    return density


def _read_extrinsics(sensor: Path) -> Pose | None:
    """The pose ``T_BS`` of a sensor in the body; None where it is not stated."""
    content = load_yaml(sensor)
    entry = content.get("T_BS") if isinstance(content, dict) else None
    data = entry.get("data") if isinstance(entry, dict) else entry
    if data is None:
        return None
    try:
        matrix = np.array(data, float).reshape(4, 4)
    except (TypeError, ValueError):
        raise SourceError(f"{sensor}: T_BS is not a matrix of 16 numbers") from None
    return pose_from_matrix(f"{sensor}: T_BS", matrix)


def _read_truth(path: Path, root: Path, body_from_cam: Pose) -> Trajectory | None:
    """The true poses, with stamps as they stand in the file."""
    stamped = []
    for row in read_rows(path, root):
        fields = [field.strip() for field in row[1].split(",")]
        stamp = stamp_of(row, fields, _STAMP)
        tx, ty, tz, qw, qx, qy, qz = numbers(row, fields[1:], 7, "timestamp,px,py,pz,qw,qx,qy,qz")
        world_from_body = pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz])
        stamped.append((stamp, world_from_body @ body_from_cam))
    return trajectory(stamped)
