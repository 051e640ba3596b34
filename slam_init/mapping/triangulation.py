"""Triangulation of points from unit rays, so that the lens model does not matter."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose


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
