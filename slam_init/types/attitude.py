"""Rotations of the camera that somebody else measured: a gyroscope, a robot's arm, another tracker."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np

from slam_init.errors import SlamInitError, check_type
from slam_init.types.arrays import Floats

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
    try:
        R = np.asarray(rotation, float)
    except (TypeError, ValueError):
        R = np.zeros(0)
    if R.shape != (3, 3) or not np.isfinite(R).all():
        raise SlamInitError("rotation: give a 3x3 matrix that maps directions in the last camera to this one")
    U, _, Vt = np.linalg.svd(R)
    nearest = np.asarray(U @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt)
    if np.abs(nearest - R).max() > _NOT_A_ROTATION:
        raise SlamInitError("rotation: the matrix is no rotation: its columns must be orthonormal, its determinant 1")
    check_type(sigma_rad, Real, "rotation_sigma_rad", "radians from 1e-6 to 1")
    if not (math.isfinite(sigma_rad) and _SIGMAS_RAD[0] <= sigma_rad <= _SIGMAS_RAD[1]):
        raise SlamInitError(f"rotation_sigma_rad is {sigma_rad!r}: give radians from 1e-6 to 1")
    return nearest
