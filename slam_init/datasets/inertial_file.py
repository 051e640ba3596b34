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

import os

from slam_init.calibration.files import load_yaml
from slam_init.calibration.values import Section, at_place
from slam_init.datasets.inertial import InertialSensor, pose_of_yaml, read_densities, read_samples
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
    values = load_yaml(sensor)
    for part in ("cam0", "imu0"):
        below = values.get(part)
        values |= below if isinstance(below, dict) else {}
    stated = Section(values)
    with at_place(sensor):
        shift_s = stated.number("timeshift_cam_imu", 0.0)
    return InertialSensor.made(
        in_seconds(stamps, time_unit(stamps)) - shift_s,
        samples,
        pose_of_yaml(f"{sensor}: T_cam_imu", values.get("T_cam_imu")),
        read_densities(sensor, stated),
        clock_sigma_s=_CALIBRATED_S if "timeshift_cam_imu" in stated.values else _UNKNOWN_S,
        name=table.name,
    )
