"""Laws of a resection: what its angles say of points at any distance."""

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.mapping.resection import resect
from slam_init.types.pose import Pose


def test_a_point_at_any_distance_is_an_inlier_if_its_ray_agrees():
    """Tracks that are nearly parallax-free put points so far away that the squares of coordinates overflow."""
    rng = np.random.default_rng(3)
    pose = Pose(rotation_from_vector(np.array([0.02, -0.05, 0.01])), np.array([0.3, -0.1, 0.05]))
    points = rng.uniform([-2.0, -2.0, 3.0], [2.0, 2.0, 6.0], (40, 3))
    points[0] = np.array([0.1, 0.2, 1.0]) * 1e200
    rays = pose.apply(points)
    bearings = rays / np.abs(rays).max(axis=1, keepdims=True)
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    with np.errstate(all="raise"):
        found = resect(points, bearings, 1e-3, Pose(pose.R, pose.t))
    assert found is not None and found[1].all()
