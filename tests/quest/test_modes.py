"""The choice between the modes of a search, and what a motion explains beside a rotation."""

from __future__ import annotations

import numpy as np
import pytest
from make_pose_matches import THRESHOLD_RAD, as_model, disturbed, pose_and_matches

from quest.chance import chance_of_motion, false_alarms_beside_rotation
from quest.noise import best_of_modes, refine_with_noise
from quest.robust.pose_problem import PoseProblem
from quest.robust.samples import RansacReport


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


def test_refinement_stays_where_the_likelihood_is_largest():
    """From a refined motion, a second refinement moves by less than its standard deviation."""
    for seed in range(10):
        R, t, m, n = pose_and_matches(seed, 200, wrong=60)
        problem = PoseProblem(m, n, THRESHOLD_RAD)
        once, _ = refine_with_noise(problem, as_model(*disturbed(R, t, seed, 1e-3)))
        twice, _ = refine_with_noise(problem, once)
        assert np.abs(twice - once).max() < 1e-4


def test_what_a_motion_explains_beside_a_rotation_is_no_chance():
    R, t, m, n = pose_and_matches(3, 60, wrong=30)
    problem, model, rng = PoseProblem(m, n, THRESHOLD_RAD), as_model(R, t), np.random.default_rng(0)
    shares = chance_of_motion(problem, model, THRESHOLD_RAD, rng).shares
    nothing, all_right = np.full(len(m), np.inf), np.zeros(len(m))
    all_right[60:] = np.inf
    assert false_alarms_beside_rotation(problem, model, nothing, shares) < 1e-10
    # Where a rotation explains all true matches, only chance is left.
    assert false_alarms_beside_rotation(problem, model, all_right, shares) > 0.1
