"""The robust estimate on degenerate and unusual scenes, by name of the scene."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, R_TRUE, T_TRUE, all_around, box, is_true, line, views
from make_views import unit

from quest import NoPose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector

# No division by zero and no overflow is allowed in the arithmetic of the estimate.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

HALF_TURNS = {"x": [np.pi, 0, 0], "y": [0, np.pi, 0], "z": [0, 0, np.pi], "slanted": list(np.pi * unit([1, -2, 2]))}


FORWARD = np.array([0, 0, 0.8])


@pytest.mark.parametrize(
    ("X", "R", "t", "options"),
    [
        *((all_around(0), rotation_from_vector(a), T_TRUE, {"outliers": 0.2}) for a in HALF_TURNS.values()),
        (box(0), np.eye(3), FORWARD, {}),
        (box(0), np.eye(3), FORWARD, {"noise_rad": 0.0}),
    ],
    ids=[*(f"half turn {axis}" for axis in HALF_TURNS), "forward", "forward, exact"],
)
def test_half_turns_and_forward_motion_without_rotation_are_estimated(X, R, t, options):
    pose = estimate_relative_pose(*views(X, R, t, **{"noise_rad": NOISE_RAD} | options))
    assert pose.kind == "general"
    assert is_true(pose, R, t, rotation_deg=0.5, direction_deg=2)


def test_an_exact_rotation_with_outliers_shows_no_translation():
    for seed in range(12):
        pose = estimate_relative_pose(*views(box(seed, 50), t=NO_TRANSLATION, outliers=0.2, seed=seed), seed=seed)
        # The pull of the outliers on the rotation turns all matches alike, and their residuals are smaller.
        assert pose.kind == "rotation"


@pytest.mark.parametrize("noise_rad", [0.0, NOISE_RAD], ids=["exact", "noisy"])
def test_points_at_infinity_give_a_rotation(noise_rad):
    pose = estimate_relative_pose(*views(1e9 * box(0), noise_rad=noise_rad, outliers=0.2))
    assert pose
    assert pose.kind == "rotation"
    assert np.degrees(rotation_angle(pose.R @ R_TRUE.T)) < 0.1


def test_near_points_determine_the_translation_beside_points_at_infinity():
    X = box(0)
    X[100:] *= 1e9
    pose = estimate_relative_pose(*views(X, noise_rad=NOISE_RAD))
    assert pose.kind == "general"
    assert is_true(pose, rotation_deg=0.3, direction_deg=2)
    assert pose.inliers[100:].mean() > 0.9


@pytest.mark.parametrize("noise_rad", [0.0, NOISE_RAD], ids=["exact", "noisy"])
@pytest.mark.parametrize("outliers", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(2))
def test_points_on_a_line_give_no_pose(seed, noise_rad, outliers):
    result = estimate_relative_pose(*views(line(seed), noise_rad=noise_rad, outliers=outliers, seed=seed))
    assert isinstance(result, NoPose)
    assert result.reason == "no_consistent_motion"


@pytest.mark.parametrize("points", [1, 2, 5, 9])
def test_repeated_matches_are_counted_once(points):
    result = estimate_relative_pose(*views(np.repeat(box(0, points), 30, axis=0)))
    assert isinstance(result, NoPose)
    assert result.reason == "too_few_matches"
    assert result.evidence.matches == points


def test_points_behind_both_cameras_are_no_inliers():
    # The rays of a quarter of the points are negated: the same epipolar lines, but the points lie behind the cameras.
    m, n = views(box(0), noise_rad=NOISE_RAD)
    m[:50], n[:50] = -m[:50], -n[:50]
    pose = estimate_relative_pose(m, n)
    assert is_true(pose, rotation_deg=0.5, direction_deg=2)
    assert not pose.inliers[:50].any()
    assert pose.inliers[50:].mean() > 0.95
