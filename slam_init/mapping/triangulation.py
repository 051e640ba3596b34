"""Triangulation of points from rays, and resection of a camera from points.

Both work on unit bearings, so that the lens model does not matter.
"""

from __future__ import annotations

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose

__all__ = ["resect", "triangulate"]


def triangulate(world_from_cam: list[Pose], bearings: Floats) -> Floats:
    """Compute the points that are nearest to their rays.

    Parameters
    ----------
    world_from_cam : list of K Pose
        Poses of the cameras.
    bearings : (K, L, 3) float
        Unit rays of L points in each camera; NaN where a view does not see a point.

    Returns
    -------
    (L, 3) float
        In the world frame. Each point minimizes the sum of its squared distances to the rays, each weighted by the
        inverse squared distance from the camera, so that the error is an angle. NaN where fewer than two rays are given
        or the rays are parallel.
    """
    count = bearings.shape[1]
    centres = np.array([pose.t for pose in world_from_cam])
    rays = np.einsum("kij,klj->kli", np.array([pose.R for pose in world_from_cam]), bearings)
    seen = np.isfinite(rays).all(axis=2)
    rays = np.where(seen[..., None], rays, 0.0)
    projectors = (np.eye(3) - rays[..., :, None] * rays[..., None, :]) * seen[..., None, None]
    weight = np.ones((len(centres), count))
    points = np.full((count, 3), np.nan)
    solvable = seen.sum(axis=0) >= 2
    for _ in range(2):  # once for the distances, once with their weights
        A = np.einsum("kl,klij->lij", weight, projectors)
        b = np.einsum("kl,klij,kj->li", weight, projectors, centres)
        # The smallest eigenvalue of A vanishes for parallel rays: over the trace it is about half the squared parallax.
        solvable &= np.linalg.eigvalsh(A)[:, 0] > 1e-12 * np.trace(A, axis1=1, axis2=2)
        points[solvable] = np.linalg.solve(A[solvable], b[solvable][..., None])[..., 0]
        points[~solvable] = np.nan
        distance = np.linalg.norm(points[None] - centres[:, None], axis=2)
        weight = 1 / np.where(np.isfinite(distance) & (distance > 0), distance, 1.0) ** 2
    return points


def resect(
    points: Floats, bearings: Floats, threshold_rad: float, guess: Pose | None = None
) -> tuple[Pose, Bools] | None:
    """Estimate the pose of a camera from points of the map.

    A minimal solver in a RANSAC loop [1]_ gives a start, which is refined on the angles between rays and points.

    Parameters
    ----------
    points : (N, 3) float
        In the world frame.
    bearings : (N, 3) float
        Unit rays of the points in the camera frame.
    threshold_rad : float
        A match is an outlier if the angle between its ray and its point is larger.
    guess : Pose, optional
        Another start, a ``cam_from_world``. The start that leads to more inliers is used.

    Returns
    -------
    (Pose, (N,) bool) or None
        ``cam_from_world`` and the inliers; None if fewer than six matches agree on a pose.

    References
    ----------
    .. [1] T. Ke, S. I. Roumeliotis, An efficient algebraic solution to the perspective-three-point problem, CVPR 2017
       (OpenCV, ``SOLVEPNP_AP3P``).
    """
    if len(points) < 6:
        return None
    candidates = [guess] if guess is not None else []
    if (minimal := _minimal_pose(points, bearings, threshold_rad)) is not None:
        candidates.append(minimal)
    best: tuple[Pose, Bools] | None = None
    for start in candidates:
        pose = start
        for scale in (4.0, 1.0):
            pose = _refine(pose, points, bearings, scale * threshold_rad)
        inliers = _angles(pose, points, bearings) < threshold_rad
        if inliers.sum() >= 6 and (best is None or inliers.sum() > best[1].sum()):
            best = pose, inliers
    return best


def _minimal_pose(points: Floats, bearings: Floats, threshold_rad: float) -> Pose | None:
    """Estimate ``cam_from_world`` by OpenCV's P3P in a RANSAC loop, on the plane z = 1."""
    import cv2

    ahead = bearings[:, 2] > 0.05
    if ahead.sum() < 6:
        return None
    xy = bearings[ahead, :2] / bearings[ahead, 2:]
    found, rotation, translation, _ = cv2.solvePnPRansac(
        points[ahead], xy, np.eye(3), np.zeros(4), iterationsCount=200, reprojectionError=threshold_rad,
        confidence=0.999, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not found or not np.isfinite(rotation).all():
        return None
    return Pose(rotation_from_vector(rotation.ravel()), np.asarray(translation, float).ravel())


def _angles(pose: Pose, points: Floats, bearings: Floats) -> Floats:
    """Return the angles (N,) between rays and their points, in the small-angle approximation."""
    X = pose.apply(points)
    return np.asarray(np.linalg.norm(X / np.linalg.norm(X, axis=1, keepdims=True) - bearings, axis=1))


def _refine(pose: Pose, points: Floats, bearings: Floats, scale_rad: float, iterations: int = 8) -> Pose:
    """Refine a pose by Gauss-Newton steps on the angles between rays and points, with a Geman-McClure kernel."""

    def residuals(pose: Pose) -> tuple[Floats, Floats, Floats]:
        X = pose.apply(points)
        distance = np.maximum(np.linalg.norm(X, axis=1), 1e-12)
        ray = X / distance[:, None]
        r = ray - bearings
        # d ray / dX = (I - ray ray^T) / distance; dX = w x X + tau for a perturbation (w, tau) from the left.
        projector = (np.eye(3) - ray[:, :, None] * ray[:, None, :]) / distance[:, None, None]
        zero = np.zeros(len(X))
        cross = np.stack(
            [
                np.stack([zero, X[:, 2], -X[:, 1]], axis=1),
                np.stack([-X[:, 2], zero, X[:, 0]], axis=1),
                np.stack([X[:, 1], -X[:, 0], zero], axis=1),
            ],
            axis=1,
        )
        J = np.concatenate([projector @ cross, projector], axis=2)
        return r, J, np.sum(r * r, axis=1)

    r, J, r2 = residuals(pose)
    scale2 = scale_rad * scale_rad
    cost, damping = float(np.sum(r2 / (scale2 + r2))), 1e-4
    for _ in range(iterations):
        weight = 1 / (1 + r2 / scale2) ** 2
        A = np.einsum("nki,n,nkj->ij", J, weight, J)
        g = np.einsum("nki,n,nk->i", J, weight, r)
        A[np.diag_indices(6)] += damping * np.diag(A) + 1e-300
        try:
            step = -np.linalg.solve(A, g)
        except np.linalg.LinAlgError:  # the points do not determine the pose: keep the current one
            break
        R = rotation_from_vector(step[:3])
        moved = Pose(R @ pose.R, R @ pose.t + step[3:])
        r_new, J_new, r2_new = residuals(moved)
        cost_new = float(np.sum(r2_new / (scale2 + r2_new)))
        if cost_new <= cost:
            gain = cost - cost_new
            pose, r, J, r2, cost = moved, r_new, J_new, r2_new, cost_new
            damping = max(0.1 * damping, 1e-9)
            if gain <= 1e-9 * cost:
                break
        else:
            damping *= 10
    return pose
