"""Laws of the vote between the best map and its rivals."""

import numpy as np
import pytest
from make_candidates import TOWARDS, bent, general_candidate, planar_candidates, planar_views, with_noise
from make_pair import estimated
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from slam_init.decision.rival_vote import vote_gates, vote_of_plane, vote_on_rivals
from slam_init.types.comparison import Margin
from slam_init.types.gates import GateName
from slam_init.types.reasons import Verdict


@pytest.fixture(scope="module")
def general():
    return general_candidate()


def test_a_map_without_rivals_needs_no_vote(general):
    vote = vote_on_rivals(CAMERA, [general], None)
    assert vote.evidence.rivals == ()
    assert vote.evidence.deciding is None
    assert vote.nearest is None


def test_a_rival_that_is_the_same_map_is_left_out(general):
    vote = vote_on_rivals(CAMERA, [general, general], None)
    assert vote.evidence.rivals == ()
    assert vote.evidence.deciding is None


def test_a_nearly_equal_rival_need_not_be_beaten_and_its_difference_counts_as_error(general):
    vague = with_noise(general, 1e4)  # with so much noise no vote decides
    vote = vote_on_rivals(CAMERA, [vague, bent(vague, 5)], None)
    assert vote.evidence.deciding is None
    assert vote.nearest is None
    assert 1 < vote.evidence.near_rival_deg <= 5 + 1e-9
    assert [each.rival for each in vote.evidence.rivals] == [1]


def test_a_distant_rival_must_be_beaten_and_is_the_nearest_one(general):
    vague = with_noise(general, 1e4)
    near, far = bent(vague, 5), bent(vague, 40)
    vote = vote_on_rivals(CAMERA, [vague, near, far], None)
    assert not vote.evidence.deciding.decides()
    assert vote.nearest is far
    assert [each.rival for each in vote.evidence.rivals] == [1, 2]


def test_a_nearly_equal_rival_that_beats_the_best_map_is_the_nearest_one(general):
    vote = vote_on_rivals(CAMERA, [bent(general, 5), general], None)
    assert vote.nearest is general
    assert vote.evidence.deciding.reversed().decides()
    assert vote.evidence.near_rival_deg == 0


def test_a_nearly_equal_rival_that_is_beaten_adds_no_error(general):
    vote = vote_on_rivals(CAMERA, [general, bent(general, 5)], None)
    assert vote.evidence.deciding.decides()
    assert vote.evidence.near_rival_deg == 0


# -- planes ---------------------------------------------------------------------------------------


def test_on_a_plane_free_points_count_only_if_the_vote_of_the_plane_is_clear():
    true, twin = planar_candidates(views=5)
    free = vote_on_rivals(CAMERA, [true, twin], None).evidence.deciding
    assert free.decides()
    doubtful, against, clear = Margin(5.0, 0.5, 3.0), Margin(-30.0, -5.0, 3.0), Margin(30.0, 3.5, 3.0)
    assert vote_on_rivals(CAMERA, [true, twin], doubtful).evidence.deciding == doubtful
    vote = vote_on_rivals(CAMERA, [true, twin], against)
    assert vote.evidence.deciding == against
    assert vote.evidence.plane == against
    assert vote_on_rivals(CAMERA, [true, twin], clear).evidence.deciding in (clear, free)


def test_the_vote_of_a_plane_takes_part_only_in_the_vote_on_the_first_rival():
    true, twin = planar_candidates(views=5)
    plane = Margin(5.0, 0.5, 3.0)
    vote = vote_on_rivals(CAMERA, [true, bent(twin, 30), twin], plane)
    assert vote.evidence.plane == plane
    assert [each.rival for each in vote.evidence.rivals] == [1, 2]
    assert vote_on_rivals(CAMERA, [true], plane).evidence.plane is None


def test_all_views_vote_on_the_two_maps_of_a_plane_and_on_nothing_else():
    seen, pair = planar_views(5), planar_candidates(views=5)
    pose = estimated(seen).pose
    margin = vote_of_plane(CONFIG, history_of(seen), seen[0], seen[-1], pose, pair)
    assert margin.decides()
    assert vote_of_plane(CONFIG, history_of(seen), seen[0], seen[-1], pose, pair[::-1]).reversed().decides()
    # One map, two equal maps, no further view, a scene that is not planar.
    assert vote_of_plane(CONFIG, history_of(seen), seen[0], seen[-1], pose, pair[:1]) is None
    assert vote_of_plane(CONFIG, history_of(seen), seen[0], seen[-1], pose, (pair[0], pair[0])) is None
    ends = [seen[0], seen[-1]]
    assert vote_of_plane(CONFIG, history_of(ends), *ends, pose, pair) is None
    rng = np.random.default_rng(0)
    general = observe(CAMERA, TOWARDS, cloud(rng, 300), 0.3, rng)
    general_pose = estimated(general).pose
    assert general_pose.kind == "general"
    assert vote_of_plane(CONFIG, history_of(seen), seen[0], seen[-1], general_pose, pair) is None


def test_both_gates_of_a_vote_pass_exactly_if_the_vote_decides():
    for margin in (Margin(25.0, 5.0), Margin(25.0, 3.0), Margin(10.0, 5.0), Margin(25.0, 3.5, z_needed=3.0)):
        z, log_likelihood = vote_gates(margin)
        assert (z.name, log_likelihood.name) == (GateName.VOTE_Z, GateName.VOTE_LOG_LIKELIHOOD)
        assert (z.passes() and log_likelihood.passes()) == margin.decides()
        assert z.threshold == margin.z_needed
        assert z.reason is log_likelihood.reason is Verdict.AMBIGUOUS_PLANE
        assert "curve" in z.advice
