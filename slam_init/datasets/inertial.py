"""The inertial sensor that is fixed to a camera: its tables, and the rotations between frames by its gyroscope.

A table holds rates and accelerations over time. A YAML file states the rest of the sensor.

A plain file is for a source of images without a sensor of its own. ``FILE.csv`` has the columns ``t, gx, gy, gz, ax,
ay, az``, separated by commas or spaces: time stamp, rates in rad/s, accelerations in m/s^2 with gravity (at rest they
point up). The stamps are on the clock of the images, in any unit that :mod:`slam_init.types.time_stamps` knows.
``FILE.yaml`` beside it states the rest, with the names of Kalibr, at the top or below ``cam0`` and ``imu0``:

* ``T_cam_imu``: the pose of the sensor in the camera, 4x4, in metres;
* ``timeshift_cam_imu``: time of the sensor minus that of the camera, seconds; optional;
* ``gyroscope_noise_density``, ``accelerometer_noise_density``: optional, by default those of phones.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.calibration.files import load_yaml
from slam_init.calibration.values import Section, at_place
from slam_init.datasets.text import fields_of, numbers, pose_from_matrix, read_rows, stamp_of
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame, Source
from slam_init.types.inertial import InertialRecord, check_deviations, check_samples, knots_between
from slam_init.types.pose import Pose
from slam_init.types.time_stamps import in_seconds, time_unit

# -- the gyroscope ---------------------------------------------------------------------------------


# The rate ``w`` is the angular velocity of the gyroscope in its own axes. With ``world_from_imu`` as its attitude,
# ``d/dt world_from_imu = world_from_imu [w]x``. Over a short step the attitude becomes ``world_from_imu exp(w dt)``, so
# that the new axes from the old ones are ``exp(-w dt)``. The product of all steps from ``t0`` to ``t1`` is brought to
# the camera by the rotation between the two:
#
#     cam1_from_cam0 = cam_from_imu  exp(-w_n dt_n) ... exp(-w_1 dt_1)  cam_from_imu^T
#
# Rates are interpolated linearly between two samples; the mean rate of each step is taken, which is exact for a
# constant rate.

#: The initializer adds the variances of the steps of a chain, but the errors of bias and scale are the same in all
#: steps. A step therefore gets the variance that makes the sum right for a chain of this length: a window of a video
#: has one or two seconds. A shorter chain is then more certain than stated, never less.
_CHAIN_S = 2.0
#: Relative error of the rate: data sheets of MEMS gyroscopes state 0.5 to 3 % of scale and cross-axis sensitivity.
_SCALE_ERROR = 0.01
#: Zero-rate offset of a MEMS gyroscope that is not calibrated. Data sheets state 0.01 to 0.35 rad/s; the one of EuRoC
#: has 0.08 rad/s.
_RAW_BIAS_RAD_S = 0.1
#: What is left of the offset once it is measured at rest: acceleration moves it by 0.002 rad/s for each g, and warming
#: by as much.
_RESTED_BIAS_RAD_S = 0.005
#: Noise density where none is stated: 0.01 deg/s/sqrt(Hz), that of the gyroscopes in phones.
NOISE_DENSITY = 2e-4
#: At rest the rate scatters by the noise alone: 0.003 rad/s at 200 Hz. A hand that holds a camera scatters by 0.02.
#: A moving hand may be calm for a single second.
_REST_S, _REST_SCATTER_RAD_S, _LEAST_RESTS = 1.0, 0.01, 2
#: A uniform turn scatters as little as rest. It is recognized by its rate, which is above the offset of most gyroscopes
#: or differs from that of other calm seconds; or by a record that is calm for nearly all of its time.
_SAME_REST_RAD_S, _MOST_REST = 0.01, 0.9
#: What :func:`slam_init.types.inertial.checked_rotation` takes.
_SIGMAS_RAD = (1e-6, 1.0)


@dataclass(frozen=True, eq=False)
class Gyroscope:
    """Angular rates over time."""

    #: (N,) Strictly increasing, on the clock of the frames.
    timestamps_s: Floats
    #: (N, 3) Angular velocity of the gyroscope in its own axes, without its known bias.
    rates_rad_s: Floats
    #: (3, 3) Maps directions of the axes of the gyroscope to the camera.
    R_cam_from_imu: Floats
    #: White noise of the rate in rad/s/sqrt(Hz).
    noise_density: float = NOISE_DENSITY
    #: Standard deviation of the constant error of the rate.
    bias_sigma_rad_s: float = _RAW_BIAS_RAD_S
    #: Standard deviation of the delay between the clocks of gyroscope and camera.
    clock_sigma_s: float = 0.0
    #: For messages.
    name: str = "the gyroscope"

    def __post_init__(self) -> None:
        R = np.asarray(self.R_cam_from_imu, float)
        check_samples(self.name, self.timestamps_s, self.rates_rad_s)
        if R.shape != (3, 3) or not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0):
            raise SourceError(f"{self.name}: the matrix from the gyroscope to the camera is no rotation")
        check_deviations(self.name, self.noise_density, self.bias_sigma_rad_s, self.clock_sigma_s)

    def between(self, t0_s: float, t1_s: float) -> tuple[Floats, float] | None:
        """Integrate the rotation of the camera between two times.

        Shapes: returns ``R`` (3, 3).

        * Returns: Instead of both, where a time lies outside of the record, two samples are more than 0.04 s apart, or
          the rotation would be uncertain by more than 1 rad.
        """
        knots = knots_between(self.timestamps_s, t0_s, t1_s)
        if knots is None:
            return None
        rates = np.stack([np.interp(knots, self.timestamps_s, rate) for rate in self.rates_rad_s.T], axis=1)
        angles = 0.5 * (rates[1:] + rates[:-1]) * np.diff(knots)[:, None]
        imu1_from_imu0 = reduce(lambda before, step: step @ before, rotation_from_vector(-angles), np.eye(3))
        duration_s = t1_s - t0_s
        scale_rad_s = _SCALE_ERROR * float(np.linalg.norm(angles.sum(axis=0))) / duration_s
        constant_rad_s = math.hypot(self.bias_sigma_rad_s, scale_rad_s)
        sigma_rad = math.hypot(
            self.noise_density * math.sqrt(duration_s),
            constant_rad_s * math.sqrt(duration_s * max(duration_s, _CHAIN_S)),
            self.clock_sigma_s * float(np.linalg.norm(rates[-1] - rates[0])),
        )
        if sigma_rad > _SIGMAS_RAD[1]:
            return None
        R = self.R_cam_from_imu @ imu1_from_imu0 @ self.R_cam_from_imu.T
        return R, max(sigma_rad, _SIGMAS_RAD[0])


def without_bias(raw: Gyroscope) -> Gyroscope:
    """Subtract the bias of a raw record: its mean rate in the seconds at rest.

    A record without such seconds, or where they may be uniform turns, stays as it is.
    """
    rates, count = raw.rates_rad_s, math.ceil(_REST_S / float(np.median(np.diff(raw.timestamps_s))))
    windows = len(rates) // count
    if count < 2 or windows < 2:
        return raw
    seconds = rates[: windows * count].reshape(windows, count, 3)
    # A second with missing samples is longer and counts as any other: at rest nothing changes.
    means, scatter = seconds.mean(axis=1), seconds.std(axis=1).max(axis=1)
    calm = (scatter < _REST_SCATTER_RAD_S) & (np.linalg.norm(means, axis=1) < _RAW_BIAS_RAD_S)
    if calm.sum() < _LEAST_RESTS or calm.mean() > _MOST_REST or np.ptp(means[calm], axis=0).max() > _SAME_REST_RAD_S:
        return raw
    return replace(raw, rates_rad_s=rates - means[calm].mean(axis=0), bias_sigma_rad_s=_RESTED_BIAS_RAD_S)


def gyroscope_of(source: Source) -> Gyroscope | None:
    """Return the gyroscope of a source.

    * ``source``: The attribute ``gyroscope`` is optional. It may be read from a file when it is asked for.
    """
    found = getattr(source, "gyroscope", None)
    if found is not None and not isinstance(found, Gyroscope):
        raise SourceError(f"{source.name}: its attribute gyroscope is no slam_init.datasets.inertial.Gyroscope")
    return found


class StepRotations:
    """Measures the rotation of each frame since the one before, as the frames are read.

    * ``gyroscope``: None measures nothing.
    * ``latest``: (3, 3) The rotation of the newest frame since the one before, and its standard deviation; None where
      nothing measured it.
    """

    def __init__(self, gyroscope: Gyroscope | None) -> None:
        self.latest: tuple[Floats, float] | None = None
        self._gyroscope = gyroscope
        self._steps = self._measured = 0

    def reading(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Pass frames through, and measure the rotation of each."""
        last_s: float | None = None
        for frame in frames:
            if self._gyroscope is not None and last_s is not None:
                self.latest = self._gyroscope.between(last_s, frame.timestamp_s)
                self._steps += 1
                self._measured += self.latest is not None
            last_s = frame.timestamp_s
            yield frame

    @property
    def notes(self) -> tuple[str, ...]:
        """How many rotations were measured, for the user."""
        if self._gyroscope is None or not self._steps:
            return ()
        name, bias = self._gyroscope.name, self._gyroscope.bias_sigma_rad_s
        if not self._measured:
            return (f"{name} measured no rotation between the frames: its samples are at other times or too far apart",)
        return (f"{name} measured {self._measured} of {self._steps} rotations between frames (bias +- {bias:g} rad/s)",)


# -- tables ----------------------------------------------------------------------------------------


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
