"""Comparison of two motions: how many matches that only one of them explains decide between the two."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make_two_views import NOISE_RAD, R_TRUE, box, is_true, views

from quest import estimate_relative_pose
from quest.alternatives import decides
from quest.noise import log_likelihood
from quest.robust.pose_problem import PoseProblem
from quest.robust.spatial_blocks import scatter_of_sum


@given(a=st.integers(0, 500), b=st.integers(0, 500), total=st.integers(0, 1000))
def test_votes_decide_for_at_most_one_side(a, b, total):
    assert not (decides(a, b, total) and decides(b, a, total))


@given(a=st.integers(0, 500), b=st.integers(1, 500), total=st.integers(0, 1000))
def test_a_vote_against_never_helps(a, b, total):
    assert decides(a, b - 1, total) or not decides(a, b, total)


@pytest.mark.parametrize(
    ("votes_for", "votes_against", "total", "decided"),
    [
        (16, 0, 100, True),
        (15, 0, 100, False),  # four deviations of 15 coins are 15.5
        (200, 150, 400, False),  # 2.7 deviations
        (200, 100, 400, True),  # 5.8 deviations
        (29, 0, 1000, False),  # a small moving object of 3 %
        (30, 0, 1000, True),
    ],
)
def test_the_number_of_votes_that_decides(votes_for, votes_against, total, decided):
    assert decides(votes_for, votes_against, total) is decided


def test_votes_from_a_single_region_do_not_decide():
    """The votes of a moving body or of a repeated texture are correlated."""
    rng = np.random.default_rng(0)
    where = rng.uniform(-1, 1, (600, 2))
    spread = np.zeros(600)
    spread[::12] = 1.0
    corner = np.where(np.argsort(np.argsort(np.linalg.norm(where + 1, axis=1))) < 50, 1.0, 0.0)
    assert spread.sum() == corner.sum() == 50
    assert decides(50, 0, 600, scatter_of_sum(spread, where))
    assert not decides(50, 0, 600, scatter_of_sum(corner, where))


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
