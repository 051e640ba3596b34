"""The inertial sensor of a phone beside a camera: what it measures along a smooth path.

An ideal sensor measures the angular velocity and the specific force in its own axes, the latter the acceleration minus
gravity. Both are central differences of the path, exact to 1e-4 of the noise. White noise, constant offsets and errors
of the scale of the axes are added, all with the deviations of the sensors in phones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.trajectory import rotation_from_vector, vector_from_rotation

#: Acceleration of gravity along z of the world, m/s^2.
GRAVITY_M_S2 = 9.80665
# Half of the steps of the differences.
_STEP_S = 1e-3
# A sensor of a phone lies some centimetres from the camera, and its axes are those of the screen: x right, y up.
_ARM_M, _MOUNTED_RAD = 0.03, 0.02


@dataclass(frozen=True)
class InertialNoise:
    """Standard deviations of the errors of an inertial sensor."""

    #: White noise in rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
    gyroscope_density: float = 2e-4
    accelerometer_density: float = 2e-3
    #: Constant offsets in rad/s and m/s^2: 1 deg/s and 10 mg.
    gyroscope_bias: float = 0.02
    accelerometer_bias: float = 0.1
    #: Relative errors of the scale of each axis.
    scale: float = 0.005


@dataclass(frozen=True, eq=False)
class InertialSamples:
    """What an inertial sensor measured."""

    #: (N,) On the clock of the frames.
    timestamps_s: Floats
    #: (N, 3) Angular velocity in the axes of the sensor.
    rates_rad_s: Floats
    #: (N, 3) Specific force in the axes of the sensor: at rest it points up.
    accelerations_m_s2: Floats
    #: (4, 4) Pose of the sensor in the camera.
    cam_from_imu: Floats
    noise: InertialNoise


def measure(
    world_from_cam: Callable[[float], Floats],
    timestamps_s: Floats,
    rng: np.random.Generator,
    noise: InertialNoise | None = None,
) -> InertialSamples:
    """Measure along a path.

    Shapes: ``timestamps_s`` (N,).

    * ``world_from_cam``: Time in seconds -> pose (4, 4). The z axis of the world points up.
    """
    noise = noise or InertialNoise()
    cam_from_imu = np.eye(4)
    # The x axis of the camera of a phone that is held upright points down.
    cam_from_imu[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ rotation_from_vector(rng.normal(0, _MOUNTED_RAD, 3))
    cam_from_imu[:3, 3] = rng.normal(0, _ARM_M, 3)

    def poses(offset_s: float) -> Floats:
        return np.array([world_from_cam(float(t)) for t in timestamps_s + offset_s]) @ cam_from_imu

    before, now, after = (poses(offset_s) for offset_s in (-_STEP_S, 0.0, _STEP_S))
    turned = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
    rates = np.array([vector_from_rotation(R) for R in turned]) / (2 * _STEP_S)
    accelerations = (before[:, :3, 3] - 2 * now[:, :3, 3] + after[:, :3, 3]) / _STEP_S**2
    accelerations[:, 2] += GRAVITY_M_S2
    forces = np.einsum("nji,nj->ni", now[:, :3, :3], accelerations)
    rate_hz = 1 / float(np.median(np.diff(timestamps_s)))
    measured = []
    for exact, bias, density in (
        (rates, noise.gyroscope_bias, noise.gyroscope_density),
        (forces, noise.accelerometer_bias, noise.accelerometer_density),
    ):
        scaled = exact * (1 + rng.normal(0, noise.scale, 3)) + rng.normal(0, bias, 3)
        measured.append(scaled + rng.normal(0, density * np.sqrt(rate_hz), exact.shape))
    return InertialSamples(timestamps_s, measured[0], measured[1], cam_from_imu, noise)
