"""Gates: each refuses for its own reason, and their measures follow the laws of error propagation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, hypothesis, observe, plane, table

from quest.estimate import estimate_relative_pose
from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.map_gates import check, direction_focal_deg
from slam_init.mapping.candidate import build_candidate
from slam_init.types.pose import Pose
from slam_init.types.reasons import ACCEPTED, REASONS, Gate

GATES = CONFIG.acceptance
#: Errors that tracks share turn the baseline of the pair by a degree at most.
SHARED_TURN_RAD = np.deg2rad(1.0)


def candidate_of(poses, noise_px=0.2, count=400, seed=1, lost=0):
    """The map of the true two-view pose; ``lost`` tracks are followed wrongly in the second frame."""
    rng = np.random.default_rng(seed)
    seen = observe(CAMERA, poses, cloud(rng, count), noise_px, rng)
    inliers = np.arange(count) >= lost
    return build_candidate(CAMERA, CONFIG, table(seen), hypothesis(poses[-1].inverse() @ poses[0], inliers))


def shrunk(factor, count=4):
    """The cameras of :func:`make_poses` on a path shorter by a factor."""
    return [Pose(pose.R, factor * pose.t) for pose in make_poses(count)]


def verdict(candidate, **changed):
    return check(CAMERA, candidate, candidate.bundle, SHARED_TURN_RAD, 0.0, replace(GATES, **changed))[0]


def measured(candidate, shared_turn_rad=SHARED_TURN_RAD):
    return {
        gate.name: gate.value for gate in check(CAMERA, candidate, candidate.bundle, shared_turn_rad, 0.0, GATES)[1]
    }


@pytest.fixture(scope="module")
def good():
    """A wide baseline, many points, little noise."""
    return candidate_of(make_poses(4))


def test_a_good_map_is_accepted_and_every_gate_says_so(good):
    result, gates = check(CAMERA, good, good.bundle, SHARED_TURN_RAD, 0.0, GATES)
    assert result == ACCEPTED
    assert all(gate.passes() for gate in gates)
    assert len({gate.name for gate in gates}) == len(gates)
    assert {gate.reason for gate in gates} <= set(REASONS)


def test_each_gate_refuses_for_its_own_reason(good):
    value = measured(good)
    assert verdict(good, min_landmarks=int(value["landmarks"]) + 1) == "too_few_landmarks"
    assert verdict(good, max_direction_error_deg=0.9 * value["direction_bound_deg"]) == "low_parallax"
    assert verdict(good, max_median_depth_sigma=0.9 * value["depth_sigma"]) == "low_parallax"
    assert verdict(replace(good, agreement=0.9 * GATES.min_further_agreement)) == "no_third_view"
    assert verdict(replace(good, agreement=float("nan"))) == "no_third_view"


def test_a_map_of_the_smaller_part_of_what_is_seen_is_refused():
    few = candidate_of(make_poses(4), lost=int(400 * (1.1 - GATES.min_explained)))
    assert verdict(few) == "no_consistent_motion"


def test_two_views_alone_are_told_apart():
    first, *_, last = make_poses(4)
    assert verdict(candidate_of([first, last])) == "no_third_view"


def test_a_short_baseline_is_low_parallax():
    assert verdict(candidate_of(shrunk(0.02), 1.0)) == "low_parallax"


def test_an_adjustment_that_turned_the_baseline_is_distrusted(good):
    turn = rotation_from_vector(np.array([0, 0, np.deg2rad(2 * GATES.max_direction_error_deg)]))
    elsewhere = replace(good.hypothesis, t=turn @ good.hypothesis.t)
    assert verdict(replace(good, hypothesis=elsewhere)) == "low_parallax"


def test_a_value_that_is_no_number_never_passes():
    assert not Gate("x", float("nan"), 0.0, True, "low_parallax", "move").passes()
    assert not Gate("x", float("nan"), 0.0, False, "low_parallax", "move").passes()
    assert Gate("x", 1.0, 1.0, True, "low_parallax", "move").passes()
    assert Gate("x", 1.0, 1.0, False, "low_parallax", "move").passes()


def test_what_more_parallax_would_lower_tells_how_much_is_lacking():
    assert Gate("x", 6.0, 3.0, False, "low_parallax", "move").lacking() == 2.0
    assert Gate("x", 3.0, 3.0, False, "low_parallax", "move").lacking() == 1.0
    assert Gate("x", 1.0, 3.0, True, "too_few_landmarks", "move").lacking() == 1.0
    assert Gate("x", float("nan"), 3.0, False, "low_parallax", "move").lacking() == 1.0


numbers = st.floats(-1e6, 1e6, allow_nan=False)


@given(numbers, st.floats(1e-3, 1e6), st.booleans())
def test_a_gate_is_fulfilled_where_it_passes_and_only_there(value, threshold, at_least):
    gate = Gate("x", value, threshold, at_least, "low_parallax", "move")
    assert 0 <= gate.fulfilled() <= 1
    assert (gate.fulfilled() == 1) == gate.passes()


def test_half_of_what_is_needed_is_half_fulfilled():
    assert Gate("x", 1.0, 2.0, True, "low_parallax", "move").fulfilled() == 0.5
    assert Gate("x", 4.0, 2.0, False, "low_parallax", "move").fulfilled() == 0.5
    for nothing in (float("nan"), float("inf")):
        assert Gate("x", nothing, 2.0, False, "low_parallax", "move").fulfilled() == 0
    assert Gate("x", float("nan"), 2.0, True, "low_parallax", "move").fulfilled() == 0


def test_every_gate_says_what_would_help_and_what_it_compared(good):
    _, gates = check(CAMERA, good, good.bundle, SHARED_TURN_RAD, 0.0, GATES)
    assert all(gate.advice for gate in gates)
    for gate in gates:
        assert gate.evidence() == {gate.name: gate.value, f"{gate.name}_gate": gate.threshold}


def test_uncertainty_grows_as_the_baseline_shrinks():
    whole, half = measured(candidate_of(make_poses(4)), 0.0), measured(candidate_of(shrunk(0.5)), 0.0)
    # Both go as noise over parallax; the noise is estimated anew from each residual.
    for name in ("direction_bound_deg", "depth_sigma"):
        assert half[name] == pytest.approx(2 * whole[name], rel=0.2)


def test_what_tracks_share_turns_a_short_baseline_farther_than_that_of_the_pair():
    """Noise is nearly none: the bound is that of the shortest baseline in the map."""
    candidate = candidate_of(make_poses(4), 0.01)
    poses = candidate.bundle.problem.world_from_cam
    lengths = [np.linalg.norm(pose.t) for pose in poses[1:]]
    expected = np.rad2deg(SHARED_TURN_RAD) * lengths[-1] / min(lengths)
    assert measured(candidate)["direction_bound_deg"] == pytest.approx(expected, rel=0.02)


def test_a_near_rival_adds_to_the_bound(good):
    alone, beside = (
        {gate.name: gate.value for gate in check(CAMERA, good, good.bundle, SHARED_TURN_RAD, near_deg, GATES)[1]}
        for near_deg in (0.0, 4.0)
    )
    assert beside.pop("direction_bound_deg") == pytest.approx(alone.pop("direction_bound_deg") + 4.0)
    assert beside == alone


def test_uncertainty_grows_with_the_noise():
    quiet, loud = (measured(candidate_of(make_poses(4), noise_px)) for noise_px in (0.2, 0.6))
    assert loud["depth_sigma"] == pytest.approx(3 * quiet["depth_sigma"], rel=0.2)
    assert loud["direction_bound_deg"] > quiet["direction_bound_deg"]


def test_more_tracks_lower_the_bound_but_not_below_what_they_share(good):
    few, many = (measured(candidate_of(make_poses(4), 0.6, count))["direction_bound_deg"] for count in (100, 1600))
    assert many < few
    shared = check(CAMERA, good, good.bundle, 4 * SHARED_TURN_RAD, 0.0, GATES)[1]
    (bound,) = (gate.value for gate in shared if gate.name == "direction_bound_deg")
    assert bound > 2 * measured(good)["direction_bound_deg"]


def test_a_focal_length_that_is_right_turns_no_direction():
    """On a plane as well, whose motion obeys more than epipolar lines."""
    rng = np.random.default_rng(1)
    poses = make_poses(4)
    seen = observe(CAMERA, poses, plane(rng, 300), 0.5, rng)
    pair = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px)
    assert pair.kind == "planar"
    candidate = build_candidate(CAMERA, CONFIG, table(seen), pair)
    assert direction_focal_deg(CAMERA, candidate, candidate.bundle, 1e-9) < 0.1
    assert direction_focal_deg(CAMERA, candidate, candidate.bundle, 0.05) > 0.1


def test_a_direction_that_hangs_on_the_focal_length_is_distrusted(good):
    """A camera that mostly turns: a focal length that is a little off turns a short baseline away."""
    turns = [rotation_from_vector(np.array([0, 0.05 * k, 0])) for k in range(4)]
    turning = [Pose(R, np.array([0.002 * k, 0, 0])) for k, R in enumerate(turns)]
    assert measured(candidate_of(turning, 0.05))["direction_focal_deg"] > 5 * measured(good)["direction_focal_deg"]
    assert verdict(candidate_of(turning, 0.05), max_direction_error_deg=1.0, focal_error=0.1) == "low_parallax"


def test_the_direction_is_as_good_as_the_bound_says():
    """Over many noises, the direction of the last camera's baseline is hardly ever beyond the bound."""
    beyond = 0
    for seed in range(20):
        candidate = candidate_of(shrunk(0.5), 0.5, 80, seed)
        problem = candidate.bundle.problem
        t, true = problem.world_from_cam[-1].t, make_poses(4)[-1].t
        error_deg = np.degrees(np.arccos(min(1.0, t @ true / np.linalg.norm(t) / np.linalg.norm(true))))
        beyond += error_deg > measured(candidate)["direction_bound_deg"]
    assert beyond <= 1
