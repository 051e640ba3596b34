"""Sequences with a list of their images and a trajectory with times of its own: TUM RGB-D and EuRoC.

**TUM RGB-D**, ICL-NUIM in its TUM-compatible form, and ETH3D SLAM:

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

**EuRoC MAV** (the ASL folder layout):

* ``mav0/cam0/data.csv`` lists ``timestamp [ns],filename``.
* ``mav0/cam0/sensor.yaml`` holds the calibration and ``T_BS`` (body_from_cam).
* ``mav0/imu0`` holds rates and accelerations in ``data.csv`` (``timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z
  [m/s^2]``), its own ``T_BS`` (body_from_imu) and its noise densities in ``sensor.yaml``. The folder is optional.
* ``mav0/state_groundtruth_estimate0/data.csv`` holds the poses world_from_body.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from slam_init.calibration.files import load_camera, load_yaml
from slam_init.calibration.values import Section
from slam_init.datasets.image_files import ImageFileSource, image_size, stored_camera
from slam_init.datasets.inertial import InertialSensor, pose_of_yaml, read_densities, read_samples
from slam_init.datasets.posed_images import Layout, file_of, image_sequence
from slam_init.datasets.text import Row, fields_of, read_rows, read_trajectory, stamp_of
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.time_stamps import TimeUnit, in_seconds, time_unit

#: Files that list the images of TUM RGB-D; the first that exists is read.
TUM_INDEX = ("rgb.txt", "associations.txt", "associated.txt")
# Published with the data sets: the colour cameras of the three Kinects of TUM RGB-D (the images of the third one are
# already undistorted), and the renderer of ICL-NUIM.
_FREIBURG_LENSES = {
    "1": (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    "2": (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
}
_FREIBURG = {
    "1": Camera("radtan", 640, 480, 517.306408, 516.469215, 318.64304, 255.313989, _FREIBURG_LENSES["1"]),
    "2": Camera("radtan", 640, 480, 520.908620, 521.007327, 325.141442, 249.701764, _FREIBURG_LENSES["2"]),
    "3": Camera("pinhole", 640, 480, 535.4, 539.2, 320.1, 247.6),
}
_ICL_NUIM = Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
_ICL_NUIM_RATE_HZ = 30.0


def _read_list(
    path: Path, folder: Path, images: Path, fields_of_image: Callable[[Row], list[str]], what: str
) -> tuple[list[Path], list[tuple[str, float]]]:
    """The images of a list, and the time stamp of each with the place of its line.

    * ``images``: Holds the images; an absolute name stays what it is.
    * ``fields_of_image``: Makes of a line the time stamp and the file name.
    """
    paths: list[Path] = []
    stamps: list[tuple[str, float]] = []
    for row in read_rows(path, folder if path.is_relative_to(folder) else None):
        fields = fields_of_image(row)
        stamps.append((row[0], stamp_of(row, fields, what)))
        if len(fields) < 2 or not fields[1]:
            raise SourceError(f"{row[0]}: expected {what}, found {row[1][:60]!r}")
        paths.append(images / fields[1])
    if not paths:
        raise SourceError(f"{path}: lists no image")
    return paths, stamps


def open_tum(folder: Path, index: Path) -> ImageFileSource:
    """Open a TUM RGB-D or ICL-NUIM folder."""
    reflected = sorted(folder.glob("*.gt.freiburg"))
    if len(reflected) > 1:
        raise SourceError(f"{folder}: several *.gt.freiburg: keep the one that belongs to the images")
    split = _time_and_name if index.name == "rgb.txt" else _colour_of_pair
    paths, stamps = _read_list(index, folder, folder, split, "a timestamp and a file name")
    camera = stored_camera(folder, paths[0], "camera.yaml", "calibration.txt")
    truth: Trajectory | None = None
    if reflected:
        stamps = [(place, stamp / _ICL_NUIM_RATE_HZ) for place, stamp in stamps]
        camera, truth = camera or _ICL_NUIM, read_trajectory(reflected[0], folder)
        truth = _reflected(truth) if truth else None
    else:
        named = re.search(r"freiburg([123])", folder.resolve().name)
        camera = camera or (_FREIBURG[named[1]] if named else None)
        if (folder / "groundtruth.txt").exists():
            truth = read_trajectory(folder / "groundtruth.txt", folder)
    return image_sequence("tum", folder, paths, stamps=stamps, camera=camera, truth=truth)


def _time_and_name(row: Row) -> list[str]:
    return row[1].split(maxsplit=1)  # a name may hold spaces


def _colour_of_pair(row: Row) -> list[str]:
    fields = row[1].split()
    return fields[2:] if len(fields) >= 4 and fields[1].lower().startswith("depth") else fields


def _reflected(truth: Trajectory) -> Trajectory:
    """The poses of ICL-NUIM for world and camera frames whose y axes point down, with times in seconds."""
    F = np.diag([1.0, -1.0, 1.0])
    poses = tuple(Pose(F @ pose.R @ F, F @ pose.t) for pose in truth.world_from_cam)
    return Trajectory(truth.timestamps_s * (1 / _ICL_NUIM_RATE_HZ), poses)


def find_euroc(folder: Path) -> Path | None:
    """Find the folder that holds the ``data.csv`` of the first camera."""
    candidates = (folder / "mav0" / "cam0", folder / "cam0", folder)
    return next((candidate for candidate in candidates if (candidate / "data.csv").is_file()), None)


def open_euroc(folder: Path, found: Path) -> ImageFileSource:
    """Open a EuRoC sequence, or its first camera."""
    cam0 = found.resolve()
    # The camera of a sequence has its ground truth beside it, so that the folder of the camera alone names its parent.
    root = cam0.parent if found == folder else folder
    paths, stamps = _read_list(cam0 / "data.csv", root, cam0 / "data", fields_of, "timestamp,filename")
    camera, body_from_cam = None, None
    sensor = cam0 / "sensor.yaml"
    if sensor.exists():
        check_inside(sensor, root)
        camera = replace(load_camera(sensor, image_size(paths[0], root)), source="machine")
        body_from_cam = _body_from(sensor, load_yaml(sensor))
    mav = cam0.parent
    truth_file = mav / "state_groundtruth_estimate0" / "data.csv"
    truth: Trajectory | None = None
    if truth_file.exists():
        columns = "timestamp tx ty tz qw qx qy qz"
        truth = read_trajectory(truth_file, root, columns, body_from_cam or Pose.identity())
    imu, notes = None, tuple[str, ...]()
    if (mav / "imu0" / "data.csv").exists():
        if body_from_cam is not None and (mav / "imu0" / "sensor.yaml").exists():
            unit = time_unit(np.array([stamp for _, stamp in stamps]), TimeUnit.NANOSECONDS)
            imu = partial(_read_imu0, mav / "imu0", root, body_from_cam, unit)
        else:
            notes = ("imu0 is not used: no sensor.yaml states its rotation against the camera (T_BS)",)
    return image_sequence(
        "euroc",
        root,
        paths,
        name=mav.parent.name if mav.name == "mav0" else mav.name,
        stamps=stamps,
        unit=TimeUnit.NANOSECONDS,
        camera=camera,
        truth=truth,
        notes=notes,
        imu=imu,
    )


def _body_from(sensor: Path, stated: Mapping[str, object]) -> Pose | None:
    """The pose ``T_BS`` of a sensor in the body; None where it is not stated."""
    entry = stated.get("T_BS")
    data = entry.get("data") if isinstance(entry, dict) else entry
    return None if data is None else pose_of_yaml(f"{sensor}: T_BS", data)


def _read_imu0(folder: Path, root: Path, body_from_cam: Pose, unit: TimeUnit) -> InertialSensor:
    """The inertial sensor; its stamps have the unit of those of the images."""
    sensor = folder / "sensor.yaml"
    check_inside(sensor, root)
    stated = load_yaml(sensor)
    body_from_imu = _body_from(sensor, stated)
    if body_from_imu is None:
        raise SourceError(f"{sensor}: no T_BS, the pose of the sensor: add it, or leave --imu out")
    stamps, samples = read_samples(folder / "data.csv", root, "timestamp,w_x,w_y,w_z (rad/s),a_x,a_y,a_z (m/s^2)")
    cam_from_imu, densities = body_from_cam.inverse() @ body_from_imu, read_densities(sensor, Section(stated))
    return InertialSensor.made(in_seconds(stamps, unit), samples, cam_from_imu, densities, name="imu0")


LAYOUTS = (
    Layout("tum", f"{', '.join(TUM_INDEX)} (TUM)", file_of(*TUM_INDEX), open_tum),
    Layout("euroc", "mav0/cam0/data.csv (EuRoC)", find_euroc, open_euroc),
)
