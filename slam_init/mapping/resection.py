"""Resection of a camera from points, on unit bearings, so that the lens model does not matter."""

from __future__ import annotations

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose

#: Largest number of Gauss-Newton steps of a refinement.
_STEPS = 8
#: A guess that explains this share of the matches is not compared with a sampled pose: of 520 views of windows with
#: four fifths and of 228 with half to four fifths none got another pose by it, and drawing takes ten times as long as
#: refining.
_EXPLAINED = 0.5
#: Largest number of sampled poses. With 200, one of 1188 views of windows got a better pose and one a worse one.
_DRAWS = 100
#: From so many times the extent of the points their rays differ by a millionth of a degree: the steps have run away.
_FARTHEST = 1e8


def resect(
    points: Floats, bearings: Floats, threshold_rad: float, guess: Pose | None = None
) -> tuple[Pose, Bools] | None:
    """Estimate the pose of a camera from points of the map.

    A minimal solver in a RANSAC loop [1]_ gives a start, which is refined on the angles between rays and points.

    .. [1] T. Ke, S. I. Roumeliotis, An efficient algebraic solution to the perspective-three-point problem, CVPR 2017
       (OpenCV, ``SOLVEPNP_AP3P``).

    Shapes: ``points`` (N, 3), ``bearings`` (N, 3), returns (N,).

    * ``threshold_rad``: A match is an outlier if the angle between its ray and its point is larger.
    * ``guess``: Another start, a ``cam_from_world``. The start that leads to more inliers is used; a guess that
      explains half of the matches is.
    * Returns: ``cam_from_world`` and the inliers; None if fewer than six matches agree on a pose.
    """
    if len(points) < 6:
        return None
    points, bearings = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(bearings, np.float64)
    best = None if guess is None else _refined(guess, points, bearings, threshold_rad)
    if best is not None and best[1].sum() >= _EXPLAINED * len(points):
        return best
    if (minimal := _minimal_pose(points, bearings, threshold_rad)) is not None:
        sampled = _refined(minimal, points, bearings, threshold_rad)
        if best is None or (sampled is not None and sampled[1].sum() > best[1].sum()):
            return sampled
    return best


def _refined(start: Pose, points: Floats, bearings: Floats, threshold_rad: float) -> tuple[Pose, Bools] | None:
    """The refined pose and its inliers; None for fewer than six."""
    from slam_init.mapping.resection_kernel import refine_absolute_pose

    R, t = start.R.copy(), start.t.copy()
    for scale in (4.0, 1.0):
        refine_absolute_pose(R, t, points, bearings, scale * threshold_rad, _STEPS)
    if not np.abs(t).max() < _FARTHEST * np.abs(points).max():
        return None
    pose = Pose(R, t)
    inliers = _angles(pose, points, bearings) < threshold_rad
    return (pose, inliers) if inliers.sum() >= 6 else None


def _minimal_pose(points: Floats, bearings: Floats, threshold_rad: float) -> Pose | None:
    """Estimate ``cam_from_world`` by OpenCV's P3P in a RANSAC loop, on the plane z = 1."""
    import cv2

    ahead = bearings[:, 2] > 0.05
    if ahead.sum() < 6:
        return None
    xy = bearings[ahead, :2] / bearings[ahead, 2:]
    found, rotation, translation, _ = cv2.solvePnPRansac(
        points[ahead], xy, np.eye(3), np.zeros(4), iterationsCount=_DRAWS, reprojectionError=threshold_rad,
        confidence=0.999, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not found or not np.isfinite(rotation).all():
        return None
    return Pose(rotation_from_vector(rotation.ravel()), np.asarray(translation, float).ravel())


def _angles(pose: Pose, points: Floats, bearings: Floats) -> Floats:
    """Return the angles (N,) between rays and their points, in the small-angle approximation."""
    X = pose.apply(points)
    # The square of a point far enough away is beyond all numbers.
    X /= np.maximum(np.abs(X).max(axis=1, keepdims=True), 1e-300)
    return np.asarray(np.linalg.norm(X / np.linalg.norm(X, axis=1, keepdims=True) - bearings, axis=1))
