"""From hypotheses to maps: the twin of a plane, the vote of further views, and what makes two maps one."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, hypothesis, observe, plane, table

from quest import estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle.problem import BundleFailure, BundleSolution
from slam_init.decision.pair_rules import vote
from slam_init.mapping.candidate import build_candidate
from slam_init.mapping.rivals import difference_of_maps_deg, explained_at_most, margin, margin_of, rank, same_map
from slam_init.mapping.views import further_views, table_of, voting_views
from slam_init.types.comparison import Margin
from slam_init.types.pose import Pose
from slam_init.types.reasons import ACCEPTED
from slam_init.types.result import Attempt

POSES = make_poses(5)
#: Towards the plane in a curve. The twin's plane is perpendicular to the baseline: only where the camera moves roughly
#: along its axis do all points lie before that one too.
TOWARDS = [
    Pose(
        rotation_from_vector(np.array([0.01, -0.02, 0.01]) * k),
        np.array([0.03 * k + 0.012 * k * k, 0.01 * k, 0.09 * k]),
    )
    for k in range(5)
]
ALL = np.ones(120, bool)


def true_hypothesis(poses=POSES, inliers=ALL):
    return hypothesis(poses[-1].inverse() @ poses[0], inliers)


def build(seen, of):
    return build_candidate(CAMERA, CONFIG, table(seen), of)


@pytest.fixture(scope="module")
def general():
    """The map of the true pose over a scene in general position."""
    rng = np.random.default_rng(1)
    return build(observe(CAMERA, POSES, cloud(rng), 0.3, rng), true_hypothesis())


def planar_candidates(views, seed=2):
    """The maps of all two-view explanations of a plane seen by the first and the last of so many views."""
    rng = np.random.default_rng(seed)
    poses = [*TOWARDS[: views - 1], TOWARDS[-1]]
    seen = observe(CAMERA, poses, plane(rng, 300), 0.3, rng)
    pose = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px, seed=0)
    assert pose.kind == "planar"
    assert len(pose.alternatives) == 1
    truth = TOWARDS[-1].inverse() @ TOWARDS[0]
    candidates = [build(seen, each) for each in (pose, *pose.alternatives)]
    off = [rotation_angle(candidate.hypothesis.R.T @ truth.R) for candidate in candidates]
    true, twin = (candidates[k] for k in np.argsort(off))
    return true, twin


def test_the_map_of_the_true_pose_is_the_scene(general):
    bundle = general.bundle
    assert isinstance(bundle, BundleSolution)
    assert len(bundle.problem.points) > 100
    assert general.agreement > 0.95
    for frame, pose in zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True):
        assert rotation_angle(pose.R.T @ POSES[frame].R) < np.deg2rad(0.3)


def test_further_views_have_a_baseline_worth_its_direction(general):
    frames = general.bundle.problem.frames
    shares = [float(np.linalg.norm(pose.t) / np.linalg.norm(POSES[-1].t)) for pose in POSES]
    assert shares[2] < 0.9 * CONFIG.map.min_motion_share < shares[3]
    assert list(frames) == [0, 3, 4]


def test_short_baselines_serve_where_there_are_no_longer_ones():
    rng = np.random.default_rng(1)
    poses = [POSES[0], POSES[1], POSES[4]]
    assert np.linalg.norm(POSES[1].t) < CONFIG.map.min_motion_share * np.linalg.norm(POSES[4].t)
    assert build(observe(CAMERA, poses, cloud(rng), 0.3, rng), true_hypothesis()).bundle.problem.frames == (0, 1, 2)


def test_where_all_further_baselines_are_short_the_longest_of_them_serve():
    """One view below the gate does not cost all its neighbours."""
    rng = np.random.default_rng(1)
    shares = (0.2, 0.5, 0.55, 0.6)
    poses = [POSES[0], *(Pose(POSES[-1].R, share * POSES[-1].t) for share in shares), POSES[-1]]
    assert shares[-1] < CONFIG.map.min_motion_share
    frames = build(observe(CAMERA, poses, cloud(rng), 0.3, rng), true_hypothesis()).bundle.problem.frames
    assert frames == (0, 2, 3, 4, 5)


def test_the_world_is_the_earliest_camera_whatever_the_order_of_the_pair():
    """Views before the pair vote too where there are none between; the first of them is the world then."""
    rng = np.random.default_rng(3)
    seen = observe(CAMERA, POSES, cloud(rng), 0.3, rng)
    of = hypothesis(POSES[4].inverse() @ POSES[3], ALL)
    candidate = build_candidate(CAMERA, CONFIG, table_of(seen[3], seen[4], seen[:3]), of)
    assert candidate.bundle.problem.frames == (0, 1, 2, 3, 4)
    np.testing.assert_allclose(candidate.bundle.problem.world_from_cam[0].t, 0, atol=1e-6)


def test_a_wrong_pose_makes_no_map_that_further_views_agree_with(general):
    turned = Pose(rotation_from_vector(np.array([0, 0.05, 0])) @ general.hypothesis.R, general.hypothesis.t[[1, 0, 2]])
    rng = np.random.default_rng(1)
    wrong = build(observe(CAMERA, POSES, cloud(rng), 0.3, rng), hypothesis(turned, ALL))
    assert isinstance(wrong.bundle, BundleFailure) or wrong.agreement < 0.5 or wrong.bundle.noise_px > 1.0
    assert rank(CAMERA, CONFIG, [wrong, general])[0] is general


def test_nothing_to_triangulate_is_a_failure_with_its_cause():
    rng = np.random.default_rng(4)
    seen = observe(CAMERA, POSES, cloud(rng))
    failed = build(seen, true_hypothesis(inliers=np.arange(120) < 4))
    assert isinstance(failed.bundle, BundleFailure)
    assert failed.bundle.cause


def test_a_planar_scene_has_two_maps_and_further_views_decide():
    true, twin = planar_candidates(views=5)
    assert not same_map(true, twin)
    assert rank(CAMERA, CONFIG, [twin, true])[0] is true
    assert margin(CAMERA, CONFIG, true, twin).decides()
    assert not margin(CAMERA, CONFIG, twin, true).decides()


def test_two_views_of_a_plane_cannot_decide():
    true, twin = planar_candidates(views=2)
    assert np.isnan(true.agreement)
    assert not margin(CAMERA, CONFIG, true, twin).decides()
    assert not margin(CAMERA, CONFIG, twin, true).decides()


def test_the_margin_changes_its_sign_with_the_order():
    true, twin = planar_candidates(views=4)
    there, back = margin(CAMERA, CONFIG, true, twin), margin(CAMERA, CONFIG, twin, true)
    assert there.log_likelihood > 0 > back.log_likelihood
    assert there.z > 0 > back.z


def test_a_map_is_the_same_as_itself_and_has_no_margin_over_itself(general):
    assert same_map(general, general)
    nothing = margin(CAMERA, CONFIG, general, general)
    assert nothing.log_likelihood == 0
    assert not nothing.decides()


def test_hypotheses_that_are_near_end_in_the_same_map(general):
    rng = np.random.default_rng(1)
    seen = observe(CAMERA, POSES, cloud(rng), 0.3, rng)
    nearby = Pose(rotation_from_vector(np.array([0, 2e-4, 0])) @ general.hypothesis.R, general.hypothesis.t)
    assert same_map(general, build(seen, hypothesis(nearby, ALL)))


def test_a_failure_is_no_map_and_is_ranked_last(general):
    failed = replace(general, bundle=BundleFailure("for this test"))
    assert not same_map(general, failed)
    assert not same_map(failed, failed)
    assert rank(CAMERA, CONFIG, [failed, general]) == [general, failed]
    assert not margin(CAMERA, CONFIG, failed, general).decides()


def test_the_table_holds_the_common_tracks_and_gaps_where_a_view_sees_none():
    seen = observe(CAMERA, POSES[:3], cloud(np.random.default_rng(5)))
    half = replace(
        seen[1], track_ids=seen[1].track_ids[::2], pixels=seen[1].pixels[::2], bearings=seen[1].bearings[::2]
    )
    joined = table_of(seen[0], seen[2], [half])
    assert joined.frames == (0, 2, 1)
    assert np.array_equal(joined.track_ids, seen[0].track_ids)
    assert np.array_equal(joined.pixels[0], seen[0].pixels)
    assert np.array_equal(joined.pixels[2, ::2], half.pixels)
    assert np.isnan(joined.pixels[2, 1::2]).all()
    assert np.isnan(joined.bearings[2, 1::2]).all()


def test_views_that_vote_lie_between_the_pair_and_are_bounded():
    poses = make_poses(12)
    seen = observe(CAMERA, poses, np.array([[0.1, 0.0, 2.0]]) + cloud(np.random.default_rng(6)))
    votes = further_views(history_of(seen), seen[0], seen[11], CONFIG.map)
    frames = [view.frame for view in votes]
    assert 0 < len(frames) <= CONFIG.map.max_further_views
    assert frames == sorted(set(frames))
    assert frames[0] > 0
    assert frames[-1] < 11


def test_views_before_the_pair_vote_where_none_lie_between():
    seen = observe(CAMERA, POSES, cloud(np.random.default_rng(7)))
    votes = further_views(history_of(seen), seen[3], seen[4], CONFIG.map)
    assert [view.frame for view in votes] == [0, 1, 2]
    assert further_views(history_of(seen[3:]), seen[3], seen[4], CONFIG.map) == []


def test_views_that_see_too_little_do_not_vote():
    seen = observe(CAMERA, POSES[:3], cloud(np.random.default_rng(8)))
    few = CONFIG.map.min_resected - 1
    blind = replace(
        seen[1], track_ids=seen[1].track_ids[:few], pixels=seen[1].pixels[:few], bearings=seen[1].bearings[:few]
    )
    assert further_views(history_of([seen[0], blind, seen[2]]), seen[0], seen[2], CONFIG.map) == []


def fewer(seen, count):
    return replace(seen, track_ids=seen.track_ids[:count], pixels=seen.pixels[:count], bearings=seen.bearings[:count])


def test_voters_come_from_the_whole_way_and_from_before_and_are_bounded():
    poses = make_poses(20)
    seen = observe(CAMERA, poses, np.array([[0.1, 0.0, 2.0]]) + cloud(np.random.default_rng(6)))
    frames = [view.frame for view in voting_views(history_of(seen), seen[5], seen[19], CONFIG.map)]
    assert len(frames) == CONFIG.map.max_voting_views
    assert frames == sorted(set(frames) - {5, 19})
    assert (frames[0], frames[-1]) == (0, 18)
    assert np.ptp(np.diff(frames)) <= 2
    # A short baseline does no harm here: the view next to the reference has a vote where there are few.
    near = [view.frame for view in voting_views(history_of(seen[:6]), seen[0], seen[5], CONFIG.map)]
    assert near == [1, 2, 3, 4]


def test_voters_see_enough_of_the_pair():
    seen = observe(CAMERA, POSES, cloud(np.random.default_rng(8)))
    needed = CONFIG.map.min_resected
    some = [seen[0], fewer(seen[1], needed - 1), fewer(seen[2], needed), seen[4]]
    assert [view.frame for view in voting_views(history_of(some), seen[0], seen[4], CONFIG.map)] == [2]
    assert voting_views(history_of([seen[0], seen[4]]), seen[0], seen[4], CONFIG.map) == []


@pytest.mark.parametrize("freedom", [1, 5, 9, 21])
def test_hardly_a_right_track_is_beyond_what_counts_as_explained(freedom):
    costs = np.random.default_rng(0).chisquare(freedom, 100_000)
    limit = explained_at_most(np.array(freedom))
    assert np.mean(costs > limit) < 0.005
    assert freedom < limit < explained_at_most(np.array(freedom + 1))


def test_a_track_without_freedom_explains_nothing():
    assert explained_at_most(np.array([0])) == 0


def test_a_margin_decides_when_both_of_its_figures_do():
    z, log_likelihood = Margin(0.0, 0.0).z_needed, Margin.LOG_LIKELIHOOD_NEEDED
    assert Margin(log_likelihood, z).decides()
    assert not Margin(0.99 * log_likelihood, 10 * z).decides()
    assert not Margin(10 * log_likelihood, 0.99 * z).decides()
    assert Margin(-log_likelihood, -z).reversed().decides()
    assert Margin(0.5 * log_likelihood, 0.8 * z).share() == pytest.approx(0.5)


def test_votes_that_neighbours_share_count_as_one():
    rng = np.random.default_rng(0)
    where = rng.uniform(0, 1, (480, 2))
    single = 0.5 + rng.normal(size=480)
    # The same votes, dealt out so that neighbours cast the same one.
    region = (where * (8, 6)).astype(int) @ (6, 1)
    shared = (0.5 + rng.normal(size=48))[region]
    assert margin_of(single, where).z > 6
    assert margin_of(shared, where).z < 0.6 * shared.sum() / np.sqrt(np.sum(shared**2))
    assert margin_of(-shared, where).z == pytest.approx(-margin_of(shared, where).z)
    assert margin_of(np.zeros(480), where).z == 0


def bent(candidate, angle_deg):
    """The same map with all its baselines turned about the first camera, in a plane that they do not stand upon."""
    problem = candidate.bundle.problem
    turn = rotation_from_vector(np.array([0.0, np.deg2rad(angle_deg), 0.0]))
    poses = tuple(Pose(pose.R, turn @ pose.t) for pose in problem.world_from_cam)
    return replace(candidate, bundle=replace(candidate.bundle, problem=replace(problem, world_from_cam=poses)))


def with_noise(candidate, noise_px):
    return replace(candidate, bundle=replace(candidate.bundle, noise_px=noise_px))


def voted(*candidates):
    return vote(CAMERA, CONFIG, Attempt((0, 1), ACCEPTED, {}), list(candidates), None)


def test_maps_differ_by_the_angles_between_their_baselines(general):
    rotation_deg, direction_deg = difference_of_maps_deg(general, bent(general, 5))
    assert rotation_deg == pytest.approx(0, abs=1e-6)
    assert 1 < direction_deg <= 5 + 1e-9
    assert difference_of_maps_deg(general, general) == pytest.approx((0, 0), abs=1e-5)
    failed = replace(general, bundle=BundleFailure("for this test"))
    assert difference_of_maps_deg(general, failed) == (np.inf, np.inf)


def test_a_rival_that_is_nearly_the_same_need_not_be_beaten_but_counts_as_error(general):
    vague = with_noise(general, 1e4)  # nothing can be told
    attempt, ruling = voted(vague, bent(vague, 5))
    assert attempt.verdict == ACCEPTED
    assert ruling.margin is None
    assert 1 < ruling.near_deg == attempt.evidence["near_rival_deg"] <= 5 + 1e-9


def test_a_rival_far_off_must_be_beaten_and_is_the_one_that_is_kept(general):
    vague = with_noise(general, 1e4)
    near, far = bent(vague, 5), bent(vague, 40)
    attempt, ruling = voted(vague, near, far)
    assert attempt.verdict == "ambiguous_plane"
    assert ruling.rival is far


def test_a_near_rival_that_beats_the_best_map_is_not_passed_over(general):
    attempt, ruling = voted(bent(general, 5), general)
    assert attempt.verdict == "ambiguous_plane"
    assert ruling.rival is general
    assert ruling.margin.reversed().decides()


def test_a_near_rival_that_is_beaten_is_none(general):
    attempt, ruling = voted(general, bent(general, 5))
    assert attempt.verdict == ACCEPTED
    assert ruling.margin.decides()
    assert ruling.near_deg == 0
