"""Laws of the hypotheses of a window: each different motion once, the best first, each with the views it locates."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import hypotheses_of, pair_and_further, point_source, pose_errors_deg, pose_of_pair, true_motion

from quest import Hypothesis
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector
from slam_init.types.frame import Observations
from slam_init.window.hypotheses import fit_hypotheses
from slam_init.window.joint_fit import Priors
from slam_init.window.tracks import gather_tracks

PRIORS = Priors(focal_sigma=0.03, field_sigma_px=0.1)


def window_of(scene, seed, views=4, **options):
    """A source, and its first and last frame with frames between."""
    source = point_source(scene, seed, **options)
    observations = list(source.observations())
    picks = np.linspace(0, len(observations) - 1, views).round().astype(int)
    return source, pair_and_further([observations[k] for k in picks], views)


def only(view: Observations, keep) -> Observations:
    """The view with some of its tracks."""
    return replace(view, track_ids=view.track_ids[keep], pixels=view.pixels[keep], bearings=view.bearings[keep])


def errors_deg(source, views, motion):
    return pose_errors_deg(motion.cam2_from_cam1, true_motion(source, views[0].frame, views[1].frame))


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_a_plane_in_two_views_has_two_motions_and_one_of_them_is_true(seed):
    source, views = window_of("wall", seed, 2, baseline=0.15)
    found = hypotheses_of(source.camera, views, PRIORS)
    assert found.planar
    assert len(found.motions) == 2
    a, b = found.motions
    assert not a.same_as(b)
    assert not b.same_as(a)
    # Two views fit both motions, except points beyond the horizon of the twin.
    assert a.fit.cost == pytest.approx(b.fit.cost, rel=0.15)
    assert min(errors_deg(source, views, motion)[1] for motion in found.motions) < 15
    for motion in found.motions:
        assert motion.fit.state.plane is not None


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_further_views_put_the_true_motion_of_a_plane_first(seed):
    source, views = window_of("wall", seed, 10, baseline=0.3)
    found = hypotheses_of(source.camera, views, PRIORS)
    rotation, direction = errors_deg(source, views, found.motions[0])
    assert rotation < 1
    assert direction < 5
    costs = [motion.fit.cost for motion in found.motions]
    assert costs == sorted(costs)


@pytest.mark.parametrize("seed", range(4))
def test_a_room_has_one_motion_and_it_is_true(seed):
    source, views = window_of("room", seed, 6)
    found = hypotheses_of(source.camera, views, PRIORS)
    assert not found.planar
    (motion,) = found.motions
    assert motion.rows == (0, 1, 2, 3, 4, 5)
    assert motion.fit.state.plane is None
    assert np.linalg.norm(motion.cam2_from_cam1.t) == pytest.approx(1)
    rotation, direction = errors_deg(source, views, motion)
    assert rotation < 0.5
    assert direction < 2


@pytest.mark.parametrize("off_rad", [0.0, 0.002])
def test_proposals_that_end_in_the_same_optimum_are_listed_once(off_rad):
    source, views = window_of("room", 1)
    pose, *_ = pose_of_pair(source.camera, *views[:2])
    near = rotation_from_vector(np.array([0, off_rad, 0])) @ pose.R
    again = Hypothesis(quaternion_from_matrix(near), near, pose.t, pose.inliers)
    found = hypotheses_of(source.camera, views, PRIORS, pose=replace(pose, alternatives=(again, again)))
    assert len(found.motions) == 1


@pytest.mark.parametrize("way", ["few tracks", "random pixels"])
def test_a_view_that_cannot_be_located_is_left_out(way):
    source, views = window_of("room", 2, 5)
    lost = views[3]
    if way == "few tracks":
        keep = np.isin(lost.track_ids, np.intersect1d(views[0].track_ids, views[1].track_ids))
        views[3] = only(lost, np.flatnonzero(keep)[:11])
    else:
        pixels = np.random.default_rng(2).uniform((0, 0), (640, 480), lost.pixels.shape)
        views[3] = replace(lost, pixels=pixels, bearings=source.camera.bearings(pixels))
    found = hypotheses_of(source.camera, views, PRIORS)
    assert found.motions[0].rows == (0, 1, 2, 4)
    assert len(found.motions[0].fit.state.R) == 4
    assert len(found.rotation_only.state.R) == 5  # the rotation-only camera sees all views
    assert errors_deg(source, views, found.motions[0])[1] < 2


def test_the_information_of_the_best_motion_allows_for_error_fields():
    source, views = window_of("wall", 0, baseline=0.3)
    best, other = hypotheses_of(source.camera, views, PRIORS).motions
    assert (best.fit.field_size, other.fit.field_size) == (12, 0)
    assert len(best.fit.information) == len(other.fit.information) + 12 * len(views)


def test_the_rotation_only_camera_explains_a_room_worse():
    source, views = window_of("room", 0)
    found = hypotheses_of(source.camera, views, PRIORS)
    assert found.rotation_only.cost > 2 * found.motions[0].fit.cost


def test_the_same_window_gives_the_same_fits():
    source, views = window_of("wall", 1, baseline=0.3)
    pose, rays1, rays2 = pose_of_pair(source.camera, *views[:2])
    a, b = (fit_hypotheses(gather_tracks(source.camera, views, 0.7), pose, rays1, rays2, PRIORS) for _ in range(2))
    assert [m.fit.cost for m in a.motions] == [m.fit.cost for m in b.motions]
    np.testing.assert_array_equal(a.motions[0].fit.state.t, b.motions[0].fit.state.t)
