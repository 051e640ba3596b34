"""The tables of inertial sensors: rates and accelerations over time, and what a YAML file states of the sensor.

A plain file is for a source of images without a sensor of its own. ``FILE.csv`` has the columns ``t, gx, gy, gz, ax,
ay, az``, separated by commas or spaces: time stamp, rates in rad/s, accelerations in m/s^2 with gravity (at rest they
point up). The stamps are on the clock of the images, in any unit that :mod:`slam_init.types.time_stamps` knows.
``FILE.yaml`` beside it states the rest, with the names of Kalibr, at the top or below ``cam0`` and ``imu0``:

* ``T_cam_imu``: the pose of the sensor in the camera, 4x4, in metres;
* ``timeshift_cam_imu``: time of the sensor minus that of the camera, seconds; optional;
* ``gyroscope_noise_density``, ``accelerometer_noise_density``: optional, by default those of phones.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slam_init.calibration.files import load_yaml
from slam_init.calibration.values import Section, at_place
from slam_init.datasets.gyroscope import NOISE_DENSITY, Gyroscope, without_bias
from slam_init.datasets.text import fields_of, numbers, pose_from_matrix, read_rows, stamp_of
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.arrays import Floats
from slam_init.types.frame import Source
from slam_init.types.inertial import InertialRecord
from slam_init.types.pose import Pose
from slam_init.types.time_stamps import in_seconds, time_unit

# Beyond the range of any sensor, in rad/s and m/s^2: a shock sensor measures up to 5000 m/s^2.
_LARGEST = 1e4
# Noise densities that are sold: of gyroscopes from a fibre-optic one on in rad/s/sqrt(Hz), of accelerometers from a
# seismic one on in m/s^2/sqrt(Hz).
_DENSITIES = {
    "gyroscope_noise_density": (1e-8, 0.1, "rad/s/sqrt(Hz), as 1.7e-4"),
    "accelerometer_noise_density": (1e-7, 1.0, "m/s^2/sqrt(Hz), as 2e-3"),
}


class InertialSensor(NamedTuple):
    """What a table of an inertial sensor holds."""

    gyroscope: Gyroscope
    #: None where the table has no accelerations.
    record: InertialRecord | None

    @staticmethod
    def made(
        timestamps_s: Floats,
        samples: Floats,
        cam_from_imu: Pose,
        stated: Mapping[str, float],
        *,
        clock_sigma_s: float | None = None,
        name: str,
    ) -> InertialSensor:
        """Make the sensor of its samples.

        Shapes: ``timestamps_s`` (N,), ``samples`` (N, 3) or (N, 6).

        * ``stated``: Noise densities, by their names in :func:`read_densities`.
        * ``clock_sigma_s``: None where one clock has taken images and samples.
        """
        rates, density = samples[:, :3], stated.get("gyroscope_density", NOISE_DENSITY)
        raw = Gyroscope(timestamps_s, rates, cam_from_imu.R, density, clock_sigma_s=clock_sigma_s or 0.0, name=name)
        if samples.shape[1] < 6:
            return InertialSensor(without_bias(raw), None)
        clock = {} if clock_sigma_s is None else {"clock_sigma_s": clock_sigma_s}
        record = InertialRecord(timestamps_s, rates, samples[:, 3:], cam_from_imu, name=name, **stated, **clock)
        return InertialSensor(without_bias(raw), record)


def of_sensor(part: str) -> Any:
    """A property of a source: a part of the sensor that is fixed to its camera; None without one.

    The source has the sensor as its attribute ``_sensor``, which is read when it is asked for.
    """
    return property(lambda source: getattr(source._sensor, part, None))


def inertial_of(source: Source) -> InertialRecord | None:
    """Return the inertial record of a source.

    * ``source``: The attribute ``inertial`` is optional. It may be read from a file when it is asked for.
    """
    found = getattr(source, "inertial", None)
    if found is not None and not isinstance(found, InertialRecord):
        raise SourceError(f"{source.name}: its attribute inertial is no slam_init.types.inertial.InertialRecord")
    return found


def read_samples(table: Path, root: Path | None, what: str) -> tuple[Floats, Floats]:
    """Read a table of time stamps, rates and accelerations.

    Shapes: returns ``stamps`` (N,), returns ``samples`` (N, 6), or (N, 3) where the table has rates alone.

    * ``what``: The columns, for messages. A line of their names is skipped.
    """
    stamps: list[float] = []
    samples: list[list[float]] = []
    columns = 0
    for row in read_rows(table, root):
        fields = fields_of(row)
        if not stamps and fields[0][:1].isalpha():
            continue
        stamp = stamp_of(row, fields, what)
        if stamps and stamp <= stamps[-1]:
            raise SourceError(f"{row[0]}: time stamp {fields[0][:40]} does not come after the one before")
        columns = columns or len(fields)
        if len(fields) != columns:  # a line that is cut off may end in the middle of a number
            raise SourceError(f"{row[0]}: has {len(fields)} fields, the first line {columns}: copy it again")
        values = numbers(row, fields[1:], 6 if columns >= 7 else 3, what)
        if max(map(abs, values)) > _LARGEST:
            raise SourceError(f"{row[0]}: {max(values, key=abs):.4g} is no measurement: give rad/s and m/s^2")
        stamps.append(stamp)
        samples.append(values)
    if len(stamps) < 2:
        raise SourceError(f"{table}: holds less than two samples of the sensor: copy it again, or leave --imu out")
    return np.array(stamps), np.array(samples)


def pose_of_yaml(place: str, value: object) -> Pose:
    """The pose of 16 numbers of a YAML file, flat or by rows."""
    try:
        matrix = np.array(value, float).reshape(4, 4)
    except (TypeError, ValueError):
        raise SourceError(f"{place} is missing or not a matrix of 4x4 numbers") from None
    return pose_from_matrix(place, matrix)


def read_densities(place: Path, stated: Section) -> dict[str, float]:
    """Read the noise densities that a YAML file states, by the names of an :class:`InertialRecord`."""
    found = {}
    with at_place(place):
        for name in stated.values.keys() & _DENSITIES:
            value, (least, most, example) = stated.number(name), _DENSITIES[name]
            if not least <= value <= most:
                raise CalibrationError(f"{name} is {value!r}: give {example}")
            found[name.replace("_noise", "")] = value
    return found


# -- a plain file ----------------------------------------------------------------------------------


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
