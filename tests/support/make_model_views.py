"""Exact pixels of two views."""

from __future__ import annotations

import numpy as np
from two_view_scenes import CAMERA

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.pose import Pose


def views(seed: int, count: int = 60, planar: bool = False) -> tuple[np.ndarray, np.ndarray, Pose]:
    """Exact pixels of points in two views, and cam2_from_cam1 with |t| = 1."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -1.5, 4], [2, 1.5, 8], (count, 3))
    if planar:
        points[:, 2] = 6 + 0.4 * points[:, 0] - 0.3 * points[:, 1]
    t = rng.normal(size=3)
    pose = Pose(rotation_from_vector(0.1 * rng.normal(size=3)), t / np.linalg.norm(t))
    # Some pixels lie outside of the image, which does not matter here.
    return CAMERA.project(points), CAMERA.project(pose.apply(points)), pose
