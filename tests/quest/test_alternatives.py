"""Comparison of two motions: which comes first."""

from __future__ import annotations

import numpy as np
from make_two_views import NOISE_RAD, R_TRUE, box, is_true, views

from quest import estimate_relative_pose
from quest.noise import log_likelihood
from quest.robust.pose_problem import PoseProblem


def test_of_two_motions_of_a_patch_the_one_whose_plane_faces_the_cameras_comes_first():
    """All points of the patch lie in front of the cameras of both motions, so that the images alone do not tell."""
    right, t = 0, np.array([0.5, 0.1, 0.3])
    for seed in range(10):
        X = np.column_stack([np.random.default_rng(seed).uniform(-0.6, 0.6, (150, 2)), np.full(150, 4.0)])
        pose = estimate_relative_pose(*views(X, t=t, noise_rad=NOISE_RAD, seed=seed), seed=seed)
        assert len(pose.alternatives) == 1
        right += is_true(pose, R_TRUE, t, rotation_deg=3, direction_deg=8)
    assert right >= 9  # where the order was left to the noise: 6


def test_the_first_alternative_of_a_rotation_is_the_most_probable_motion():
    for seed in range(10):
        m, n = views(15 * box(seed, 60), noise_rad=NOISE_RAD, outliers=0.3, seed=seed)
        pose, problem = estimate_relative_pose(m, n, seed=seed), PoseProblem(m, n, 2e-3)
        assert pose.kind == "rotation"
        models = [np.concatenate([other.q_wxyz, other.t]) for other in pose.alternatives]
        assert np.argmax([log_likelihood(problem, model) for model in models]) == 0
