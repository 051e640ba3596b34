"""Bundle problems: parallax of the landmarks, and selection of observations."""

import numpy as np
from make_scene import CAMERA, cloud, problem

from slam_init.types.pose import Pose


def test_parallax_is_the_largest_angle_between_two_rays():
    poses = tuple(Pose(np.eye(3), np.array([x, 0, 0])) for x in (0.0, 0.1, -0.1))
    found = problem(CAMERA, np.array([[0.0, 0, 1.0]]), poses).parallax_rad()
    np.testing.assert_allclose(found, 2 * np.arctan(0.1))


def test_a_landmark_without_a_second_view_is_dropped():
    exact = problem(CAMERA, cloud(np.random.default_rng(8), 30))
    chosen = (exact.landmarks != 5) | (exact.views == 0)
    kept = exact.keep(chosen)
    assert 15 not in kept.track_ids  # the id of point 5
    assert len(kept.points) == 29
    assert np.abs(kept.residuals(CAMERA)).max() < 1e-9
