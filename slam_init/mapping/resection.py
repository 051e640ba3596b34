"""Resection of a camera from points, and triangulation, on unit bearings, so that the lens model does not matter."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.algebra import copy_pose, solve_in_place, turn
from quest.geometry.quaternion import rotation_from_vector
from quest.jit import compiler_of
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose

compiled = compiler_of(Path(__file__).parent)
part = compiler_of(Path(__file__).parent, part=True)

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
#: Damping at the start, its factor after each step that fails or succeeds, and its least value.
_DAMPING, _RAISE, _LEAST_DAMPING = 1e-4, 10.0, 1e-9
#: The steps end where one lowers the cost by less than this share.
_TOLERANCE = 1e-9


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


@compiled
def refine_absolute_pose(R: Floats, t: Floats, points: Floats, bearings: Floats, scale_rad: float, steps: int) -> None:
    """Refine a pose by Gauss-Newton steps on the angles between rays and points, with a Geman-McClure kernel.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``points`` (N, 3), ``bearings`` (N, 3).
    """
    scale2 = scale_rad * scale_rad
    A, g = np.zeros((6, 6)), np.zeros(6)
    cost, damping = _accumulate(R, t, points, bearings, scale2, A, g), _DAMPING
    tried_R, tried_t = np.empty((3, 3)), np.empty(3)
    tried_A, tried_g, turned = np.zeros((6, 6)), np.zeros(6), np.zeros((3, 3))
    for _ in range(steps):
        for i in range(6):  # not by slices: their assignment takes the compiler three seconds
            for j in range(6):
                tried_A[i, j] = A[i, j]
            tried_A[i, i] += damping * A[i, i] + 1e-300
            tried_g[i] = -g[i]
        if not solve_in_place(tried_A, tried_g):
            return  # the points do not determine the pose: keep the current one
        # The pose is moved from the left: its translation turns too.
        copy_pose(R, t, tried_R, tried_t)
        turn(tried_R, tried_g[0], tried_g[1], tried_g[2])
        turned[0, 0], turned[1, 0], turned[2, 0] = t[0], t[1], t[2]
        turn(turned, tried_g[0], tried_g[1], tried_g[2])
        for i in range(3):
            tried_t[i] = turned[i, 0] + tried_g[3 + i]
        lower = _accumulate(tried_R, tried_t, points, bearings, scale2, tried_A, tried_g)
        if lower <= cost:
            gain, cost = cost - lower, lower
            copy_pose(tried_R, tried_t, R, t)
            A, tried_A = tried_A, A
            g, tried_g = tried_g, g
            damping = max(damping / _RAISE, _LEAST_DAMPING)
            if gain <= _TOLERANCE * cost:
                return
        else:
            damping *= _RAISE


@part
def _accumulate(R: Floats, t: Floats, points: Floats, bearings: Floats, scale2: float, A: Floats, g: Floats) -> float:
    """Robust cost, and the normal equations (A, g) of a step (w, tau) from the left: ``dX = w x X + tau``."""
    A[:], g[:] = 0.0, 0.0
    cost = 0.0
    X, ray, r = np.empty(3), np.empty(3), np.empty(3)
    J = np.empty((3, 6))
    for n in range(len(points)):
        for i in range(3):
            X[i] = R[i, 0] * points[n, 0] + R[i, 1] * points[n, 1] + R[i, 2] * points[n, 2] + t[i]
        distance = max(np.sqrt(X[0] * X[0] + X[1] * X[1] + X[2] * X[2]), 1e-12)
        r2 = 0.0
        for i in range(3):
            ray[i] = X[i] / distance
            r[i] = ray[i] - bearings[n, i]
            r2 += r[i] * r[i]
        cost += r2 / (scale2 + r2)
        weight = 1.0 / (1.0 + r2 / scale2) ** 2
        for i in range(3):
            # d ray / dX = (I - ray ray^T) / distance
            for j in range(3):
                J[i, 3 + j] = -ray[i] * ray[j] / distance
            J[i, 3 + i] += 1.0 / distance
            J[i, 0] = J[i, 5] * X[1] - J[i, 4] * X[2]
            J[i, 1] = J[i, 3] * X[2] - J[i, 5] * X[0]
            J[i, 2] = J[i, 4] * X[0] - J[i, 3] * X[1]
        for i in range(6):
            g[i] += weight * (J[0, i] * r[0] + J[1, i] * r[1] + J[2, i] * r[2])
            for j in range(i + 1):
                A[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j] + J[2, i] * J[2, j])
    for i in range(6):
        for j in range(i):
            A[j, i] = A[i, j]
    return cost


def triangulate(world_from_cam: list[Pose], bearings: Floats) -> Floats:
    """Compute the points that are nearest to their rays.

    Shapes: ``bearings`` (K, L, 3), returns (L, 3).

    * ``bearings``: Unit rays of L points in each camera; NaN where a view does not see a point.
    * Returns: In the world frame. Each point minimizes the sum of its squared distances to the rays, each weighted by
      the inverse squared distance from the camera, so that the error is an angle. NaN where fewer than two rays are
      given or the rays are parallel.
    """
    centres = np.array([pose.t for pose in world_from_cam])
    rays = np.swapaxes(bearings @ np.array([pose.R.T for pose in world_from_cam]), 0, 1)
    seen = np.isfinite(rays).all(axis=2)
    rays = np.where(seen[..., None], rays, 0.0)
    places = np.einsum("lki,ki->lk", rays, centres)  # of the centres along the rays
    points, weight = np.full((len(rays), 3), np.nan), seen.astype(float)
    solvable = seen.sum(axis=1) >= 2
    for _ in range(2):  # once for the distances, once with their weights
        A = weight.sum(axis=1)[:, None, None] * np.eye(3) - np.swapaxes(weight[..., None] * rays, 1, 2) @ rays
        b = weight @ centres - ((weight * places)[:, None] @ rays)[:, 0]
        # The smallest eigenvalue of A vanishes for parallel rays: over the trace it is about half the squared parallax.
        solvable &= np.linalg.eigvalsh(A)[:, 0] > 1e-12 * np.trace(A, axis1=1, axis2=2)
        points[solvable] = np.linalg.solve(A[solvable], b[solvable][..., None])[..., 0]
        points[~solvable] = np.nan
        distance = np.linalg.norm(points[:, None] - centres, axis=2)
        weight = seen / np.where(np.isfinite(distance) & (distance > 0), distance, 1.0) ** 2
    return points


def parallax_rad(points: Floats, centre: Floats, other: Floats) -> Floats:
    """Angles (N,) between the rays from two camera centres (3,) to points (N, 3)."""
    a, b = points - centre, points - other
    cosine = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))
