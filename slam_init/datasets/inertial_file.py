"""A plain file of an inertial sensor, for a source of images without one.

``FILE.csv`` has the columns ``t, gx, gy, gz, ax, ay, az``, separated by commas or spaces: time stamp, rates in rad/s,
accelerations in m/s^2 with gravity (at rest they point up). The stamps are on the clock of the images, in any unit that
:mod:`slam_init.types.time_stamps` knows. ``FILE.yaml`` beside it states the rest, with the names of Kalibr, at the top
or below ``cam0`` and ``imu0``:

* ``T_cam_imu``: the pose of the sensor in the camera, 4x4, in metres;
* ``timeshift_cam_imu``: time of the sensor minus that of the camera, seconds; optional;
* ``gyroscope_noise_density``, ``accelerometer_noise_density``: optional, by default those of phones.
"""

from __future__ import annotations

import math
import os

import numpy as np

from slam_init.calibration.files import load_yaml
from slam_init.datasets.inertial import InertialSensor, read_densities, read_samples
from slam_init.datasets.text import pose_from_matrix
from slam_init.errors import SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.time_stamps import in_seconds, time_unit

#: Kalibr finds the delay of two clocks to a millisecond. Where nobody has, drivers are late by some milliseconds.
_CALIBRATED_S, _UNKNOWN_S = 0.001, 0.005


def read_inertial_file(path: str | os.PathLike[str]) -> InertialSensor:
    """Read a file of an inertial sensor, with the YAML file beside it."""
    table = user_path(path)
    stamps, samples = read_samples(table, None, "t,gx,gy,gz,ax,ay,az (rad/s, m/s^2)")
    sensor = table.with_suffix(".yaml")
    if not sensor.exists():
        raise SourceError(f"{sensor}: no such file: write T_cam_imu in it, the pose of the sensor in the camera (4x4)")
    content = load_yaml(sensor)
    stated = dict(content) if isinstance(content, dict) else {}
    for part in ("cam0", "imu0"):
        below = stated.get(part)
        stated |= below if isinstance(below, dict) else {}
    try:
        cam_from_imu = pose_from_matrix(f"{sensor}: T_cam_imu", np.array(stated.get("T_cam_imu"), float).reshape(4, 4))
    except (TypeError, ValueError):
        raise SourceError(f"{sensor}: T_cam_imu is missing or not a matrix of 4x4 numbers") from None
    shift = stated.get("timeshift_cam_imu")
    if shift is not None and not (isinstance(shift, int | float) and math.isfinite(shift)):
        raise SourceError(f"{sensor}: timeshift_cam_imu is {shift!r}: give seconds")
    return InertialSensor.made(
        in_seconds(stamps, time_unit(stamps)) - (shift or 0.0),
        samples,
        cam_from_imu,
        read_densities(sensor, stated),
        clock_sigma_s=_UNKNOWN_S if shift is None else _CALIBRATED_S,
        name=table.name,
    )
