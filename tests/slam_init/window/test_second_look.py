"""Laws of the second look: the scene has no vote, and motions that no pair proposed are found."""

from dataclasses import replace

import numpy as np
import pytest
from make_hard_worlds import drive_behind_a_logo, ground_and_poles, shifted_frames_before_a_wall
from make_window import hypotheses_of, hypotheses_of_changing_lens, pair_and_further, point_source
from make_window import hypotheses_of_scene as hypotheses

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.pose import Pose
from slam_init.window import last_look, second_look
from slam_init.window.last_look import after_last_look
from slam_init.window.levels import PRINCIPAL_SIGMA
from slam_init.window.motion import difference_deg, fit_motion
from slam_init.window.other_motion import bearings_of_best
from slam_init.window.risk import risk_of
from slam_init.window.second_look import look_again
from slam_init.window.state import Priors

PRIORS = Priors(focal_sigma=0.03)
WRONG_DEG = 15.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [13, 19])
def test_points_near_a_plane_have_no_vote_for_a_motion(seed):
    """With a plane the wrong motion is ahead by hundreds of nats; with free depths the right one leads."""
    error_deg = ground_and_poles(seed)
    assert error_deg is None or error_deg < WRONG_DEG


def test_points_on_the_planes_of_two_motions_vote_by_the_plane():
    """A distance for each point lets a wrong motion of a wall follow the noise."""
    found = hypotheses_of_changing_lens("wall", 4, baseline=0.05, points=300)
    assert risk_of(look_again(found)).rival > 0.1
    again, risk = after_last_look(found, risk_of(found), max_risk=0.005)
    assert again.planar
    assert risk.total < 0.005


@pytest.mark.slow
def test_tracks_of_a_static_logo_do_not_hold_the_camera():
    error_deg = drive_behind_a_logo(3)
    assert error_deg is not None
    assert error_deg < WRONG_DEG


@pytest.mark.slow
def test_frames_that_are_shifted_as_a_whole_make_no_false_map():
    error_deg = shifted_frames_before_a_wall(20)
    assert error_deg is None or error_deg < WRONG_DEG


@pytest.mark.parametrize(("seed", "kept"), [(0, 0), (5, 1)])
def test_the_other_motion_of_a_plane_is_found_where_one_was_proposed(seed, kept):
    found = hypotheses("wall", seed, 2, baseline=0.3)
    single = replace(found, motions=found.motions[kept : kept + 1])
    again = look_again(single)
    assert not again.planar
    for motion in found.motions:
        assert any(max(motion.difference_deg(other)) < 5 for other in again.motions)


def test_a_small_risk_of_an_ambiguous_plane_is_not_confirmed_where_its_rival_was_not_proposed():
    found = hypotheses("wall", 0, 2, baseline=0.3)
    single = replace(found, motions=found.motions[:1])
    risk = risk_of(single)
    assert risk.rival == 0
    _, again = after_last_look(single, risk, max_risk=1.0)
    assert again.rival > 0.1
    assert again.total > risk.total


def test_a_turn_about_the_optical_axis_over_flat_ground_leaves_the_direction_known():
    """There the image moves by the error of the principal point; a calibration knows it well enough."""
    source = point_source("nadir-turn", 0, baseline=0.1)
    priors = replace(PRIORS, principal_sigma_px=PRINCIPAL_SIGMA * source.camera.width)
    risk = risk_of(hypotheses_of(source.camera, pair_and_further(list(source.observations()), 12), priors))
    assert risk.direction < 0.005


def test_a_room_is_confirmed_as_it_is():
    found = hypotheses("room", 0, 6)
    risk = risk_of(found)
    same, again = after_last_look(found, risk, max_risk=0.005)
    assert again.total == pytest.approx(risk.total, abs=1e-3)
    assert same.motions[0].same_as(found.motions[0])


@pytest.mark.parametrize("steps", [0, 2])
def test_a_rival_that_only_free_depths_find_has_the_risk_of_hypotheses_with_it(steps):
    """The motion is the same, so that only the term of the rivals is stated anew."""
    found = hypotheses("room", 0, 3)
    best, risk = found.motions[0], risk_of(found)
    poses = dict(best.motion.cam_from_world)
    second = best.frames[1]
    poses[second] = Pose(poses[second].R, rotation_from_vector(np.array([0.0, 0.5, 0.0])) @ poses[second].t)
    rival = fit_motion(found.tracks, replace(best.motion, cam_from_world=poses), PRIORS, max_steps=steps)
    with_rival = replace(found, motions=(best, rival))
    again, stated = last_look._with_free_depths(found, risk, with_rival)
    assert again.motions == with_rival.motions
    assert stated.directions is risk.directions
    assert (stated.rotation, stated.moving) == (risk.rotation, risk.moving)
    whole = risk_of(with_rival)
    assert whole.margin is not None
    assert (stated.rival, stated.margin) == (pytest.approx(whole.rival, rel=1e-9), whole.margin)


def test_all_tracks_of_the_pair_propose_again_even_where_a_wrong_motion_explains_them(monkeypatch):
    """Before a corridor of equal panels a wrong motion explained 162 tracks, and the right one 176."""
    found = hypotheses("room", 1, 2)
    right = found.motions[0]
    poses = dict(right.motion.cam_from_world)
    second = right.frames[1]
    poses[second] = Pose(rotation_from_vector(np.array([0.0, 0.1, 0.0])) @ poses[second].R, np.array([0.6, 0.5, 0.6]))
    wrong = fit_motion(found.tracks, replace(right.motion, cam_from_world=poses), PRIORS, max_steps=0)
    assert max(wrong.difference_deg(right)) > WRONG_DEG
    monkeypatch.setattr(second_look, "explained_tracks", lambda _: np.ones(len(found.tracks.track_ids), bool))
    misled = replace(found, motions=(wrong,))
    bearings = bearings_of_best(misled)
    starts = second_look._poses_to_start_from(misled, np.isfinite(bearings).all(axis=(0, 2)), bearings)
    assert min(max(difference_deg(start, right.cam2_from_cam1)) for start in starts) < 2.0
