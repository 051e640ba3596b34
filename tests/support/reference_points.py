"""The fit of points to their rays in numpy, as the compiled loop has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.graph import CAUCHY
from slam_init.bundle.problem import BundleProblem
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera

STEPS, DAMPING = 5, 1e-6


def fit_points(camera: Camera, problem: BundleProblem, noise_px: float) -> BundleProblem:
    """As :func:`slam_init.bundle.points.fit_points`."""
    rays = camera.bearings(problem.pixels)
    R = np.array([pose.R for pose in problem.world_from_cam])[problem.views]
    rays = np.einsum("mij,mj->mi", R, rays)
    centres = np.array([pose.t for pose in problem.world_from_cam])[problem.views]
    points, landmarks = problem.points, problem.landmarks
    scale_rad = CAUCHY * noise_px / camera.focal_px
    for _ in range(STEPS):
        offsets = points[landmarks] - centres
        distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-300)
        # The part of the offset across the ray, as an angle. Its derivative is the projector over the distance.
        along = np.einsum("mi,mi->m", offsets, rays)
        errors = (offsets - along[:, None] * rays) / distances[:, None]
        weights = 1 / (1 + np.einsum("mi,mi->m", errors, errors) / scale_rad**2)
        weights = np.where(np.isfinite(weights), weights, 0.0) / distances**2
        projectors = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        A = _sums(landmarks, (weights[:, None, None] * projectors).reshape(-1, 9), len(points)).reshape(-1, 3, 3)
        b = _sums(landmarks, (weights * distances)[:, None] * errors, len(points))
        A += DAMPING * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
        moved = points - np.linalg.solve(A, b[..., None])[..., 0]
        ahead = np.einsum("mi,mi->m", moved[landmarks] - centres, rays) > 0
        ahead |= along <= 0
        keeps = np.bincount(landmarks, weights=~ahead, minlength=len(points)) == 0
        points = np.where((keeps & np.isfinite(moved).all(axis=1))[:, None], moved, points)
    return replace(problem, points=points)


def _sums(groups: Ints, values: Floats, count: int) -> Floats:
    """Sums (count, K) of values (M, K) by group."""
    return np.stack([np.bincount(groups, weights=column, minlength=count) for column in values.T], axis=1)
