"""Rigid transformations and time-stamped trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix
from slam_init.types.arrays import Floats

__all__ = ["Pose", "Trajectory"]


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transformation ``X_a = R X_b + t``, named ``a_from_b``. Poses are composed by ``@``.

    Attributes
    ----------
    R : (3, 3) float
        Rotation matrix.
    t : (3,) float
        Translation.
    """

    R: Floats
    t: Floats

    @staticmethod
    def identity() -> Pose:
        """Make the identity.

        Returns
        -------
        Pose
        """
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_quaternion(q_wxyz: Floats, t: Floats) -> Pose:
        """Make a pose from a quaternion and a translation.

        Parameters
        ----------
        q_wxyz : (4,) float
            Hamilton quaternion, w first, of any norm except 0.
        t : (3,) float

        Returns
        -------
        Pose
        """
        return Pose(matrix_from_quaternion(np.asarray(q_wxyz, float)), np.asarray(t, float))

    @property
    def q_wxyz(self) -> Floats:
        """Unit Hamilton quaternion, w first, ``w >= 0``."""
        return quaternion_from_matrix(self.R)

    @property
    def centre(self) -> Floats:
        """For ``cam_from_world``: the position of the camera in the world, ``-R^T t``."""
        return -self.R.T @ self.t

    def inverse(self) -> Pose:
        """Invert the transformation.

        Returns
        -------
        Pose
            ``b_from_a``.
        """
        return Pose(self.R.T, -self.R.T @ self.t)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.R @ other.t + self.t)

    def apply(self, points: Floats) -> Floats:
        """Transform points from frame b to frame a.

        Parameters
        ----------
        points : (..., 3) float
            In frame b.

        Returns
        -------
        (..., 3) float
            In frame a.
        """
        return points @ self.R.T + self.t


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Time-stamped poses ``world_from_cam``.

    Attributes
    ----------
    timestamps_s : (N,) float
        Strictly increasing.
    world_from_cam : tuple of N Pose
    """

    timestamps_s: Floats
    world_from_cam: tuple[Pose, ...]

    def at(self, timestamp_s: float, tolerance_s: float = 0.02) -> Pose | None:
        """Find the pose that is nearest in time.

        Parameters
        ----------
        timestamp_s : float
        tolerance_s : float
            Largest difference of the time stamps.

        Returns
        -------
        Pose or None
            ``world_from_cam``; None if no pose is within the tolerance.
        """
        if len(self.timestamps_s) == 0:
            return None
        i = int(np.argmin(np.abs(self.timestamps_s - timestamp_s)))
        return self.world_from_cam[i] if abs(self.timestamps_s[i] - timestamp_s) <= tolerance_s else None
