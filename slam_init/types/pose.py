"""Rigid transformations and time-stamped trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix
from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats

# A thousandth of a pixel at a focal length of 1000 px. A matrix with larger errors was not meant as a rotation.
_ROTATION_TOLERANCE = 1e-6


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

    def __post_init__(self) -> None:
        for name, value, shape in (("R", self.R, (3, 3)), ("t", self.t, (3,))):
            if not isinstance(value, np.ndarray) or value.shape != shape:
                found = f"shape {value.shape}" if isinstance(value, np.ndarray) else f"type {type(value).__name__}"
                raise SlamInitError(f"{name} of a pose has the {found}: give an array of the shape {shape}")

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

        Raises
        ------
        SlamInitError
            If the quaternion is zero or not finite.
        """
        q = np.asarray(q_wxyz, float)
        if not (np.isfinite(q).all() and q.any()):
            raise SlamInitError(f"quaternion {q.tolist()} is zero or not finite: it is no rotation")
        return Pose(matrix_from_quaternion(q), np.asarray(t, float))

    def problem(self) -> str | None:
        """Find why this is no rigid transformation, for poses of other programs.

        Returns
        -------
        str or None
            The rest of a sentence that starts with the pose; None where ``R R^T = 1`` and ``det R = 1`` up to 1e-6 and
            t is finite.
        """
        R, t = self.R, self.t
        if {R.dtype.kind, t.dtype.kind} - set("fiu"):
            return f"has R of shape {R.shape} and t of shape {t.shape}: give numbers (3, 3) and (3,)"
        if not (np.isfinite(t).all() and (np.abs(R) < 2).all()):
            return "has a number that is not finite or too large: give a rotation and a finite translation"
        if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            return "has a matrix R that is no rotation: give an orthogonal one of determinant 1"
        return None

    @property
    def q_wxyz(self) -> Floats:
        """Unit Hamilton quaternion, w first, ``w >= 0``."""
        return quaternion_from_matrix(self.R)

    @property
    def centre(self) -> Floats:
        """For ``cam_from_world``: the position of the camera in the world, ``-R^T t``."""
        return -self.R.T @ self.t

    def matrix(self) -> Floats:
        """The transformation as a matrix.

        Returns
        -------
        (4, 4) float
            ``[[R, t], [0, 1]]``, so that homogeneous points of frame b become those of frame a.
        """
        return np.block([[self.R, self.t[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

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

    def __post_init__(self) -> None:
        times, poses = self.timestamps_s, self.world_from_cam
        if not isinstance(times, np.ndarray) or times.ndim != 1 or not isinstance(poses, tuple | list):
            raise SlamInitError("a trajectory has the times as an array (N,), and the poses as a tuple: give these")
        if len(times) != len(poses) or not all(isinstance(pose, Pose) for pose in poses):
            raise SlamInitError(
                f"a trajectory has {len(times)} times for {len(poses)} poses: give a Pose for each time"
            )

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
