"""Laws of the stages of an attempt, each with the typed input that the stage before it returns."""

from dataclasses import replace

import numpy as np
import pytest
from make_candidates import TOWARDS
from make_map import make_poses
from make_pair import estimated, matched, preview_of
from make_scene import CAMERA, CONFIG, cloud, history_of, observe, plane

from quest.estimate import NoPose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.attempt import build_maps, estimate_two_views, try_pair
from slam_init.bundle.problem import BundleSolution
from slam_init.decision.correlated_error import rounding_error_px
from slam_init.decision.two_views import match_pair
from slam_init.types.gates import Stage
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.stopwatch import Stopwatch

POSES = make_poses(5)
#: Straight towards a plane: all views agree with its twin.
STRAIGHT = [Pose(np.eye(3), k * np.array([0.02, 0.0, 0.06])) for k in range(5)]


def general(poses=POSES, noise_px=0.3, seed=0):
    rng = np.random.default_rng(seed)
    return observe(CAMERA, poses, cloud(rng, 300), noise_px, rng)


def planar(poses, noise_px=0.3, seed=2):
    rng = np.random.default_rng(seed)
    return observe(CAMERA, poses, plane(rng, 300), noise_px, rng)


def tried(seen, third_view=True):
    history, stopwatch = history_of(seen), Stopwatch()
    return try_pair(CAMERA, CONFIG, history, preview_of(seen), seen[-1], stopwatch, third_view=third_view)


def direction_error_deg(t, true):
    return np.degrees(np.arccos(np.clip(t @ true / np.linalg.norm(t) / np.linalg.norm(true), -1, 1)))


# -- matches --------------------------------------------------------------------------------------


def test_a_matched_pair_holds_the_common_tracks_row_by_row():
    seen = general()
    half = replace(
        seen[-1], track_ids=seen[-1].track_ids[::2], pixels=seen[-1].pixels[::2], bearings=seen[-1].bearings[::2]
    )
    pair = match_pair(history_of(seen), preview_of([seen[0], half]), half)
    np.testing.assert_array_equal(pair.pixels1, seen[0].pixels[::2])
    np.testing.assert_array_equal(pair.pixels2, half.pixels)
    np.testing.assert_array_equal(pair.rays1, seen[0].bearings[::2])
    np.testing.assert_array_equal(pair.rays2, half.bearings)
    assert pair.reference is seen[0]
    assert pair.current is half


# -- two views ------------------------------------------------------------------------------------


def test_the_two_view_estimate_is_the_true_motion_within_its_bounds():
    estimate = estimated(general())
    truth = POSES[-1].inverse() @ POSES[0]
    assert rotation_angle(estimate.pose.R.T @ truth.R) < np.deg2rad(0.5)
    error_deg = direction_error_deg(estimate.pose.t, truth.t)
    assert error_deg < 3 * np.degrees(np.hypot(estimate.pose.direction_sigma_rad, estimate.correlated_turn_rad))
    assert estimate.threshold_rad == CONFIG.two_view.threshold_px / CAMERA.focal_px
    assert estimate.correlated_rad >= CONFIG.acceptance.min_correlated_error_px / CAMERA.focal_px
    assert 0 < estimate.jackknife_rad < np.deg2rad(5)


def test_the_outlier_threshold_is_widened_for_noisy_tracks():
    estimate = estimated(general(noise_px=2.0))
    assert estimate.threshold_rad == pytest.approx(3 * CONFIG.two_view.threshold_px / CAMERA.focal_px)
    assert estimate.pose.inliers.mean() > 0.9


def test_whole_pixels_count_as_correlated_errors():
    seen = [replace(view, pixels=np.round(view.pixels)) for view in general()]
    seen = [replace(view, bearings=CAMERA.bearings(view.pixels)) for view in seen]
    assert estimated(seen).correlated_rad >= rounding_error_px(seen[0].pixels) / CAMERA.focal_px > 0


def test_a_rotation_only_camera_explains_a_rotation_which_has_no_direction_error():
    rotated = Pose(rotation_from_vector(np.array([0.0, 0.05, 0.0])), np.zeros(3))
    estimate = estimated(general([Pose.identity(), rotated]))
    assert estimate.pose.kind == "rotation"
    assert estimate.jackknife_rad == 0
    assert estimate.rotation_only.residual_rad < 1.5 * 0.3 / CAMERA.focal_px


def test_unrelated_rays_have_no_pose():
    pair = matched(general())
    shuffled = replace(pair, rays2=np.random.default_rng(0).permutation(pair.rays2))
    assert isinstance(estimate_two_views(CAMERA, CONFIG, shuffled), NoPose)


# -- maps -----------------------------------------------------------------------------------------


def test_a_general_scene_has_one_map_with_further_views():
    seen = general()
    maps = build_maps(CAMERA, CONFIG, history_of(seen), matched(seen), estimated(seen))
    (candidate,) = maps.candidates
    assert isinstance(candidate.bundle, BundleSolution)
    assert maps.table.frames[:2] == (0, 4)
    assert len(maps.table.frames) > 2
    assert maps.plane is None


def test_a_plane_has_two_maps_and_the_better_one_comes_first():
    seen = planar(TOWARDS)
    maps = build_maps(CAMERA, CONFIG, history_of(seen), matched(seen), estimated(seen))
    first, second = maps.candidates
    truth = TOWARDS[-1].inverse() @ TOWARDS[0]
    off = [rotation_angle(candidate.hypothesis.R.T @ truth.R) for candidate in (first, second)]
    assert off[0] < off[1]
    assert maps.plane.decides()


def test_without_a_third_view_the_maps_have_two_views_and_no_vote():
    seen = planar(TOWARDS)
    maps = build_maps(CAMERA, CONFIG, history_of(seen), matched(seen), estimated(seen), third_view=False)
    assert maps.table.frames == (0, 4)
    assert maps.plane is None


# -- all stages -----------------------------------------------------------------------------------


def test_a_good_pair_passes_all_stages_with_the_evidence_of_each():
    outcome = tried(general())
    attempt = outcome.attempt
    assert (attempt.verdict, attempt.stage, attempt.progress) == (Verdict.ACCEPTED, None, 1.0)
    assert outcome.accepted is not None
    assert outcome.unconfirmed is None
    assert outcome.hypotheses == ()
    assert attempt.frames[:2] == (0, 4)
    assert {view.frame for view in outcome.accepted.views} <= set(attempt.frames)
    assert None not in (attempt.preview, attempt.two_view, attempt.rotation_only, attempt.vote, attempt.map)
    assert attempt.two_view.kind == "general"
    assert not attempt.failed_gates
    assert len(attempt.pixels1) == len(attempt.inliers) == 300


def test_a_rotation_is_refused_before_any_map():
    rotations = [Pose(rotation_from_vector(np.array([0.0, 0.02 * k, 0.0])), np.zeros(3)) for k in range(3)]
    outcome = tried(general(rotations))
    assert (outcome.attempt.verdict, outcome.attempt.stage) == (Verdict.PURE_ROTATION, Stage.MOTION)
    assert outcome.attempt.vote is outcome.attempt.map is None
    assert outcome.accepted is None


def test_a_short_baseline_is_refused_with_the_required_baseline():
    outcome = tried(general([Pose(pose.R, 0.03 * pose.t) for pose in POSES]))
    assert outcome.attempt.verdict == Verdict.LOW_PARALLAX
    assert outcome.attempt.parallax_shortfall > 1


def test_unrelated_matches_are_no_consistent_motion():
    seen = general()
    mixed = replace(seen[-1], bearings=np.random.default_rng(0).permutation(seen[-1].bearings))
    outcome = tried([*seen[:-1], mixed])
    assert (outcome.attempt.verdict, outcome.attempt.stage) == (Verdict.NO_CONSISTENT_MOTION, Stage.TWO_VIEWS)
    assert not outcome.attempt.inliers.any()
    assert outcome.attempt.two_view.kind is None


def test_an_undecided_plane_keeps_both_maps():
    outcome = tried(planar(STRAIGHT, 0.5))
    assert (outcome.attempt.verdict, outcome.attempt.stage) == (Verdict.AMBIGUOUS_PLANE, Stage.MAP)
    assert len(outcome.hypotheses) == 2
    assert not outcome.margin.decides()
    assert outcome.margin == outcome.attempt.vote.deciding
    assert outcome.accepted is None


def test_a_pair_without_a_third_view_is_kept_for_the_end_or_accepted_at_once():
    first, *_, last = general()
    waiting = tried([first, last])
    assert waiting.attempt.verdict == Verdict.NO_THIRD_VIEW
    assert waiting.unconfirmed is not None
    taking = tried([first, last], third_view=False)
    assert taking.attempt.verdict == Verdict.ACCEPTED
    np.testing.assert_array_equal(taking.accepted.map.points, waiting.unconfirmed.map.points)


def test_an_undecided_pair_of_two_views_is_not_kept_for_the_end():
    """The first and the last view of a plane have a rival, and no view can exclude it."""
    first, *_, last = planar(TOWARDS)
    outcome = tried([first, last])
    assert outcome.attempt.verdict == Verdict.AMBIGUOUS_PLANE
    assert outcome.unconfirmed is None
