"""Laws of the gates of a map: each refuses for its own reason, and their figures follow error propagation."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, hypothesis, observe, plane, table

from quest.estimate import estimate_relative_pose
from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.map_gates import direction_focal_deg, judge_map, map_gates
from slam_init.mapping.candidate import build_candidate
from slam_init.types.gates import GateName, Stage
from slam_init.types.pose import Pose
from slam_init.types.reasons import REASONS, Verdict
from slam_init.types.result import Attempt

GATES = CONFIG.acceptance
#: Correlated tracking errors turn the baseline of the pair by at most a degree.
CORRELATED_TURN_RAD = np.deg2rad(1.0)


def candidate_of(poses, noise_px=0.2, count=400, seed=1, lost=0):
    """The map of the true two-view pose; the first ``lost`` tracks are outliers of the pair."""
    rng = np.random.default_rng(seed)
    seen = observe(CAMERA, poses, cloud(rng, count), noise_px, rng)
    inliers = np.arange(count) >= lost
    return build_candidate(CAMERA, CONFIG, table(seen), hypothesis(poses[-1].inverse() @ poses[0], inliers))


def shrunk(factor, count=4):
    """The cameras of :func:`make_poses` on a path that is shorter by a factor."""
    return [Pose(pose.R, factor * pose.t) for pose in make_poses(count)]


def judged(candidate, third_view=True, **changed):
    attempt, config = Attempt((0, 3), Verdict.ACCEPTED), replace(GATES, **changed)
    return judge_map(
        CAMERA, attempt, candidate, candidate.bundle, CORRELATED_TURN_RAD, 0.0, config, third_view=third_view
    )


def verdict(candidate, **changed):
    return judged(candidate, **changed).verdict


def measured(candidate, correlated_turn_rad=CORRELATED_TURN_RAD, near_rival_deg=0.0):
    gates = map_gates(CAMERA, candidate, candidate.bundle, correlated_turn_rad, near_rival_deg, GATES)
    return {gate.name: gate.value for gate in gates}


@pytest.fixture(scope="module")
def good():
    """A wide baseline, many points, little noise."""
    return candidate_of(make_poses(4))


def test_a_good_map_is_accepted_and_all_gates_pass(good):
    attempt = judged(good)
    assert attempt.verdict == Verdict.ACCEPTED
    assert attempt.stage is None
    assert attempt.map.reprojection_rmse_px == good.bundle.rmse_px
    assert all(gate.passes() for gate in attempt.gates)
    assert len({gate.name for gate in attempt.gates}) == len(attempt.gates)
    assert {gate.reason for gate in attempt.gates} <= set(REASONS)
    assert all(gate.advice for gate in attempt.gates)


def test_a_refusal_takes_stage_advice_and_progress_from_its_gate(good):
    value = measured(good)["direction_bound_deg"]
    attempt = judged(good, max_direction_error_deg=0.8 * value)
    (failed,) = attempt.failed_gates
    assert failed.name is GateName.DIRECTION_BOUND_DEG
    assert (attempt.verdict, attempt.stage, attempt.advice) == (Verdict.LOW_PARALLAX, Stage.MAP, failed.advice)
    assert attempt.parallax_shortfall == pytest.approx(1 / 0.8)
    assert attempt.progress == pytest.approx((3 + 0.8) / 4)


def test_each_gate_refuses_for_its_own_reason(good):
    value = measured(good)
    assert verdict(good, min_landmarks=int(value["landmarks"]) + 1) == "too_few_landmarks"
    assert verdict(good, max_direction_error_deg=0.9 * value["direction_bound_deg"]) == "low_parallax"
    assert verdict(good, max_median_depth_sigma=0.9 * value["depth_sigma"]) == "low_parallax"
    assert verdict(replace(good, agreement=0.9 * GATES.min_further_agreement)) == "no_third_view"
    assert verdict(replace(good, agreement=float("nan"))) == "no_third_view"


def test_a_map_that_explains_the_smaller_part_of_the_tracks_is_refused():
    few = candidate_of(make_poses(4), lost=int(400 * (1.1 - GATES.min_explained)))
    assert verdict(few) == "no_consistent_motion"


def test_a_map_of_two_views_is_accepted_only_if_no_third_view_is_required():
    first, *_, last = make_poses(4)
    assert judged(candidate_of([first, last])).verdict == "no_third_view"
    without = judged(candidate_of([first, last]), third_view=False)
    assert without.verdict == Verdict.ACCEPTED
    assert {gate.reason for gate in without.failed_gates} == {Verdict.NO_THIRD_VIEW}


def test_a_short_baseline_is_low_parallax():
    assert verdict(candidate_of(shrunk(0.02), 1.0)) == "low_parallax"


def test_a_map_whose_adjustment_turned_the_baseline_is_refused(good):
    turn = rotation_from_vector(np.array([0, 0, np.deg2rad(2 * GATES.max_direction_error_deg)]))
    elsewhere = replace(good.hypothesis, t=turn @ good.hypothesis.t)
    assert verdict(replace(good, hypothesis=elsewhere)) == "low_parallax"


def test_uncertainty_grows_as_the_baseline_shrinks():
    whole, half = measured(candidate_of(make_poses(4)), 0.0), measured(candidate_of(shrunk(0.5)), 0.0)
    # Both are proportional to noise over parallax; the noise is estimated from the residuals of each map.
    for name in ("direction_bound_deg", "depth_sigma"):
        assert half[name] == pytest.approx(2 * whole[name], rel=0.2)


def test_a_correlated_error_turns_a_short_baseline_more_than_that_of_the_pair():
    """The noise is nearly zero, so the bound is that of the shortest baseline in the map."""
    candidate = candidate_of(make_poses(4), 0.01)
    poses = candidate.bundle.problem.world_from_cam
    lengths = [np.linalg.norm(pose.t) for pose in poses[1:]]
    expected = np.rad2deg(CORRELATED_TURN_RAD) * lengths[-1] / min(lengths)
    assert measured(candidate)["direction_bound_deg"] == pytest.approx(expected, rel=0.02)


def test_the_difference_from_a_near_rival_is_added_to_the_bound(good):
    alone, beside = (measured(good, near_rival_deg=near_deg) for near_deg in (0.0, 4.0))
    assert beside.pop("direction_bound_deg") == pytest.approx(alone.pop("direction_bound_deg") + 4.0)
    assert beside == alone


def test_uncertainty_grows_with_the_noise():
    quiet, loud = (measured(candidate_of(make_poses(4), noise_px)) for noise_px in (0.2, 0.6))
    assert loud["depth_sigma"] == pytest.approx(3 * quiet["depth_sigma"], rel=0.2)
    assert loud["direction_bound_deg"] > quiet["direction_bound_deg"]


def test_more_tracks_lower_the_bound_but_not_below_the_correlated_error(good):
    few, many = (measured(candidate_of(make_poses(4), 0.6, count))["direction_bound_deg"] for count in (100, 1600))
    assert many < few
    assert measured(good, 4 * CORRELATED_TURN_RAD)["direction_bound_deg"] > 2 * measured(good)["direction_bound_deg"]


def test_a_focal_length_without_error_turns_no_direction():
    """Also on a plane, where the pose of the candidate is not the best one on epipolar lines."""
    rng = np.random.default_rng(1)
    poses = make_poses(4)
    seen = observe(CAMERA, poses, plane(rng, 300), 0.5, rng)
    pair = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px)
    assert pair.kind == "planar"
    candidate = build_candidate(CAMERA, CONFIG, table(seen), pair)
    assert direction_focal_deg(CAMERA, candidate, candidate.bundle, 1e-9) < 0.1
    assert direction_focal_deg(CAMERA, candidate, candidate.bundle, 0.05) > 0.1


def test_a_direction_that_depends_on_the_focal_length_is_refused(good):
    """If a camera mostly rotates, a small error of the focal length turns the short baseline."""
    rotations = [rotation_from_vector(np.array([0, 0.05 * k, 0])) for k in range(4)]
    rotating = [Pose(R, np.array([0.002 * k, 0, 0])) for k, R in enumerate(rotations)]
    assert measured(candidate_of(rotating, 0.05))["direction_focal_deg"] > 5 * measured(good)["direction_focal_deg"]
    assert verdict(candidate_of(rotating, 0.05), max_direction_error_deg=1.0, focal_error=0.1) == "low_parallax"


def test_the_direction_error_is_hardly_ever_larger_than_its_bound():
    """At most once in 20 draws of the noise, for the baseline of the last camera."""
    beyond = 0
    for seed in range(20):
        candidate = candidate_of(shrunk(0.5), 0.5, 80, seed)
        problem = candidate.bundle.problem
        t, true = problem.world_from_cam[-1].t, make_poses(4)[-1].t
        error_deg = np.degrees(np.arccos(min(1.0, t @ true / np.linalg.norm(t) / np.linalg.norm(true))))
        beyond += error_deg > measured(candidate)["direction_bound_deg"]
    assert beyond <= 1
