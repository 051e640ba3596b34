"""The noise of a motion, the choice between the modes of a search, and what chance explains."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import NOISE_RAD, THRESHOLD_RAD, as_model, disturbed, pose_and_matches

from quest.geometry.epipolar import tangent_basis
from quest.geometry.quaternion import matrix_from_quaternion, vector_from_rotation
from quest.noise import best_of_modes, refine_with_noise
from quest.robust.lo_ransac import RansacReport
from quest.robust.pose_problem import PoseProblem
from tests.benchmarks.quest.reference import refine_pose, sampson_jacobian

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


@laws
@given(seed=SEEDS, angle_rad=st.floats(0, 1e-3), wrong=st.integers(0, 25))
def test_outliers_move_the_refined_motion_by_less_than_its_noise(seed, angle_rad, wrong):
    R, t, m, n = pose_and_matches(seed, 80, wrong=wrong)
    start = as_model(*disturbed(R, t, seed, angle_rad))
    before = start.tobytes()
    model, _ = refine_with_noise(PoseProblem(m, n, THRESHOLD_RAD), start)
    assert start.tobytes() == before
    R_right, t_right = refine_pose(R, t, m[wrong:], n[wrong:], 1.0, iterations=50)
    _, J = sampson_jacobian(R_right, t_right, m[wrong:], n[wrong:])
    turn = vector_from_rotation(matrix_from_quaternion(model[:4]) @ R_right.T)
    difference = J @ np.concatenate([turn, tangent_basis(t_right).T @ model[4:]])
    # Least squares of the right matches errs by five in the mean.
    assert difference @ difference < 12 * NOISE_RAD**2


@pytest.mark.parametrize("count", [40, 900])
@pytest.mark.parametrize("right", [0, 1])
def test_the_motion_with_the_better_matches_is_chosen_wherever_it_stands(count, right):
    for seed in range(10):
        R, t, m, n = pose_and_matches(seed, count, wrong=count // 4)
        problem = PoseProblem(m, n, THRESHOLD_RAD)
        models = [as_model(*disturbed(R, t, seed, angle_rad)) for angle_rad in (2e-3, 0.1)]
        report = RansacReport(np.array(models if right == 0 else models[::-1]), np.zeros(2), 1)
        best, _, others = best_of_modes(problem, report, count, np.random.default_rng(seed))
        assert abs(best[:4] @ as_model(R, t)[:4]) > np.cos(0.01)
        assert len(others) <= 1
