"""Laws of the decision on the relative pose of a pair: each source of direction error refuses, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_pair import estimated, matched
from make_scene import CAMERA, CONFIG, cloud, observe

from quest.estimate import NoPose
from quest.geometry.quaternion import rotation_from_vector
from slam_init.attempt import estimate_two_views
from slam_init.decision.two_views import judge_two_views, two_view_evidence
from slam_init.types.gates import GateName, Stage
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

MAX_DEG = CONFIG.acceptance.max_direction_error_deg
MAX_RAD = np.deg2rad(MAX_DEG)


def views(poses, noise_px=0.3):
    rng = np.random.default_rng(0)
    return observe(CAMERA, poses, cloud(rng, 300), noise_px, rng)


def judged(estimate):
    return judge_two_views(CAMERA, CONFIG, Attempt((0, 1), Verdict.ACCEPTED), estimate)


@pytest.fixture(scope="module")
def wide():
    """The estimate of a pair with a wide baseline."""
    return estimated(views(make_poses(4)))


@pytest.fixture(scope="module")
def rotating():
    """The estimate of a pair of a rotation-only camera."""
    return estimated(views([Pose.identity(), Pose(rotation_from_vector(np.array([0.0, 0.05, 0.0])), np.zeros(3))]))


def test_a_wide_baseline_passes_with_all_gates_of_the_stage(wide):
    attempt = judged(wide)
    assert attempt.verdict == Verdict.ACCEPTED
    assert attempt.stage is None
    assert all(gate.passes() for gate in attempt.gates)
    assert {gate.name for gate in attempt.gates} == {
        GateName.INLIER_SHARE,
        GateName.TWO_VIEW_DIRECTION_SIGMA_DEG,
        GateName.DIRECTION_CORRELATED_DEG,
        GateName.DIRECTION_JACKKNIFE_DEG,
    }


@pytest.mark.parametrize(
    ("worse", "failed"),
    [
        (lambda e: replace(e, correlated_turn_rad=2 * MAX_RAD), GateName.DIRECTION_CORRELATED_DEG),
        (lambda e: replace(e, jackknife_rad=2 * MAX_RAD / 3), GateName.DIRECTION_JACKKNIFE_DEG),
        (
            lambda e: replace(e, pose=replace(e.pose, covariance=(2 * MAX_RAD) ** 2 * np.eye(5))),
            GateName.TWO_VIEW_DIRECTION_SIGMA_DEG,
        ),
    ],
)
def test_each_source_of_direction_error_alone_is_low_parallax(wide, worse, failed):
    attempt = judged(worse(wide))
    assert (attempt.verdict, attempt.stage) == (Verdict.LOW_PARALLAX, Stage.TWO_VIEWS)
    assert [gate.name for gate in attempt.failed_gates] == [failed]
    assert attempt.advice == attempt.failed_gates[0].advice


def test_the_gates_by_noise_tell_the_required_baseline_and_the_jackknife_does_not(wide):
    by_noise = judged(replace(wide, correlated_turn_rad=2 * MAX_RAD, jackknife_rad=3 * MAX_RAD))
    assert by_noise.parallax_shortfall == pytest.approx(2)
    by_jackknife = judged(replace(wide, jackknife_rad=3 * MAX_RAD))
    assert by_jackknife.parallax_shortfall <= 1


def test_a_motion_that_explains_too_few_matches_is_no_consistent_motion(wide):
    few = np.arange(len(wide.pose.inliers)) < 0.5 * CONFIG.two_view.min_inlier_share * len(wide.pose.inliers)
    attempt = judged(replace(wide, pose=replace(wide.pose, inliers=few), correlated_turn_rad=2 * MAX_RAD))
    assert attempt.verdict == Verdict.NO_CONSISTENT_MOTION
    assert attempt.parallax_shortfall == 1


def test_a_rotation_is_pure_rotation_and_one_within_the_noise_is_a_static_camera(rotating):
    assert rotating.pose.kind == "rotation"
    attempt = judged(rotating)
    assert (attempt.verdict, attempt.stage) == (Verdict.PURE_ROTATION, Stage.MOTION)
    within_noise = rotation_from_vector(np.array([0.0, 0.1 / CAMERA.focal_px, 0.0]))
    static = judged(replace(rotating, pose=replace(rotating.pose, R=within_noise)))
    assert (static.verdict, static.stage) == (Verdict.STATIC_CAMERA, Stage.MOTION)
    assert [gate.name for gate in static.failed_gates] == [GateName.ROTATION_PX]


def test_the_evidence_of_an_estimate_is_in_pixels_and_degrees(wide):
    evidence = two_view_evidence(CAMERA, wide)
    assert evidence.kind == "general"
    assert evidence.alternatives == len(wide.pose.alternatives)
    assert evidence.noise_px == pytest.approx(0.3, rel=0.2)
    assert evidence.correlated_error_px == pytest.approx(wide.correlated_rad * CAMERA.focal_px)
    assert evidence.direction_sigma_deg == pytest.approx(np.degrees(wide.pose.direction_sigma_rad))


def test_the_evidence_of_no_pose_holds_the_statistics_alone():
    pair = matched(views(make_poses(4)))
    shuffled = replace(pair, rays2=np.random.default_rng(0).permutation(pair.rays2))
    estimate = estimate_two_views(CAMERA, CONFIG, shuffled)
    assert isinstance(estimate, NoPose)
    evidence = two_view_evidence(CAMERA, estimate)
    assert evidence.statistics is estimate.evidence
    assert evidence.kind is evidence.noise_px is evidence.alternatives is None
