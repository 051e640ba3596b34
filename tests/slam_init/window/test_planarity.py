"""The plane that the matches of a motion lie on."""

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.pose import Pose
from slam_init.window.planarity import plane_of_motion

#: A tilted plane at a distance of about 1, and a motion in front of it.
PLANE = np.array([0.2, -0.3, 0.8])
MOTION = Pose(rotation_from_vector(np.array([0.08, -0.2, 0.04])), np.array([0.4, 0.32, -0.24]))


def test_the_plane_of_a_motion_is_the_one_that_most_points_are_on():
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform([-0.6, -0.4], [0.6, 0.4], (200, 2)), np.ones(200)])
    X /= (X @ PLANE)[:, None]
    X[:40] *= rng.uniform(1.2, 2.0, (40, 1))
    Y = MOTION.apply(X)
    m, n = (P / np.linalg.norm(P, axis=1, keepdims=True) for P in (X, Y))
    np.testing.assert_allclose(plane_of_motion(MOTION.R, MOTION.t, m, n), PLANE, rtol=1e-3)
