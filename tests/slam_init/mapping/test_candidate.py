"""Laws of the map of a hypothesis: the true motion gives the scene, a wrong one gives no map that views agree with."""

import numpy as np
import pytest
from make_candidates import ALL, POSES, build, general_candidate, general_views, true_hypothesis
from make_scene import CAMERA, CONFIG, cloud, hypothesis, observe

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle.problem import BundleFailure, BundleSolution
from slam_init.mapping.candidate import build_candidate
from slam_init.mapping.rivals import rank
from slam_init.mapping.views import table_of
from slam_init.types.pose import Pose


@pytest.fixture(scope="module")
def general():
    return general_candidate()


def test_the_map_of_the_true_motion_is_the_scene(general):
    bundle = general.bundle
    assert isinstance(bundle, BundleSolution)
    assert len(bundle.problem.points) > 100
    assert general.agreement > 0.95
    assert general.placed == 5
    for frame, pose in zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True):
        assert rotation_angle(pose.R.T @ POSES[frame].R) < np.deg2rad(0.3)


def test_further_views_with_a_short_baseline_are_left_out(general):
    shares = [float(np.linalg.norm(pose.t) / np.linalg.norm(POSES[-1].t)) for pose in POSES]
    assert shares[2] < 0.9 * CONFIG.map.min_motion_share < shares[3]
    assert general.bundle.problem.frames == (0, 3, 4)


def test_a_further_view_with_a_short_baseline_is_used_if_there_is_no_other():
    poses = [POSES[0], POSES[1], POSES[4]]
    assert np.linalg.norm(POSES[1].t) < CONFIG.map.min_motion_share * np.linalg.norm(POSES[4].t)
    assert build(general_views(poses), true_hypothesis()).bundle.problem.frames == (0, 1, 2)


def test_if_all_further_baselines_are_short_those_near_the_longest_are_used():
    shares = (0.2, 0.5, 0.55, 0.6)
    poses = [POSES[0], *(Pose(POSES[-1].R, share * POSES[-1].t) for share in shares), POSES[-1]]
    assert shares[-1] < CONFIG.map.min_motion_share
    assert build(general_views(poses), true_hypothesis()).bundle.problem.frames == (0, 2, 3, 4, 5)


def test_the_world_is_the_earliest_camera_also_if_further_views_come_before_the_pair():
    rng = np.random.default_rng(3)
    seen = observe(CAMERA, POSES, cloud(rng), 0.3, rng)
    of = hypothesis(POSES[4].inverse() @ POSES[3], ALL)
    candidate = build_candidate(CAMERA, CONFIG, table_of(seen[3], seen[4], seen[:3]), of)
    assert candidate.bundle.problem.frames == (0, 1, 2, 3, 4)
    np.testing.assert_allclose(candidate.bundle.problem.world_from_cam[0].t, 0, atol=1e-6)


def test_a_wrong_motion_makes_no_map_that_further_views_agree_with(general):
    turned = Pose(rotation_from_vector(np.array([0, 0.05, 0])) @ general.hypothesis.R, general.hypothesis.t[[1, 0, 2]])
    wrong = build(general_views(), hypothesis(turned, ALL))
    assert isinstance(wrong.bundle, BundleFailure) or wrong.agreement < 0.5 or wrong.bundle.noise_px > 1.0
    assert rank(CAMERA, [wrong, general])[0] is general


def test_too_few_points_are_a_failure_with_its_cause():
    seen = observe(CAMERA, POSES, cloud(np.random.default_rng(4)))
    failed = build(seen, true_hypothesis(inliers=np.arange(120) < 4))
    assert isinstance(failed.bundle, BundleFailure)
    assert failed.bundle.cause == "only 4 points can be triangulated"
