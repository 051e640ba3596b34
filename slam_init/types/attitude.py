"""Rotations of the camera that somebody else measured: a gyroscope, a robot's arm, another tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats, as_array, as_number

#: A matrix that is farther from a rotation was not meant as one: numbers of four digits are nearer.
_NOT_A_ROTATION = 1e-3
#: Standard deviations of a measured rotation, in radians: nothing measures better than the least; more than the most is
#: no measurement.
_SIGMAS_RAD = (1e-6, 1.0)


@dataclass(frozen=True, eq=False)
class Attitude:
    """The measured rotation of the camera since some frame."""

    #: (3, 3)
    cam_from_start: Floats
    #: Of each component of its rotation vector; the sum of those of the steps.
    variance_rad2: float
    #: Frame since which the rotation of every frame was measured.
    start: int

    def after(self, rotation: Floats, sigma_rad: float) -> Attitude:
        """The attitude in the next frame.

        Shapes: ``rotation`` (3, 3).
        """
        return Attitude(rotation @ self.cam_from_start, self.variance_rad2 + sigma_rad**2, self.start)


def checked_rotation(rotation: object, sigma_rad: float) -> Floats:
    """Check a measured rotation.

    Shapes: ``rotation`` (3, 3), returns (3, 3).
    """
    R = as_array(rotation, np.float64, (3, 3), "rotation", "a 3x3 matrix from the axes of the last camera to these")
    U, _, Vt = np.linalg.svd(R)
    nearest = np.asarray(U @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt)
    if not np.abs(nearest - R).max() <= _NOT_A_ROTATION:  # nor NaN, of numbers that are too large
        raise SlamInitError("rotation: the matrix is no rotation: its columns must be orthonormal, its determinant 1")
    if not _SIGMAS_RAD[0] <= as_number(sigma_rad, "rotation_sigma_rad", "radians from 1e-6 to 1") <= _SIGMAS_RAD[1]:
        raise SlamInitError(f"rotation_sigma_rad is {sigma_rad!r}: give radians from 1e-6 to 1")
    return nearest
