"""Laws of the hypotheses of a window: each different motion once, the best first, each with the views it locates."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import (
    hypotheses_of,
    is_motion_of,
    motion_errors_deg,
    motions_of,
    pose_of_pair,
    true_motion,
    window_of,
)

from quest import Hypothesis
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector
from slam_init.types.pose import Pose
from slam_init.window.hypotheses import fit_hypotheses
from slam_init.window.locating import align_with_first
from slam_init.window.motion import Motion
from slam_init.window.state import Priors
from slam_init.window.tracks import gather_tracks

PRIORS = Priors(focal_sigma=0.03)


@pytest.mark.parametrize("seed", range(2))
def test_a_room_has_one_motion_and_it_is_true(seed):
    source, views = window_of("room", seed, 6)
    found = hypotheses_of(source.camera, views, PRIORS)
    assert not found.planar
    (motion,) = found.motions
    assert motion.rows == (0, 1, 2, 3, 4, 5)
    assert motion.fit.state.plane is None
    assert np.linalg.norm(motion.cam2_from_cam1.t) == pytest.approx(1)
    assert is_motion_of(source, motion, 0.5, 2)


@pytest.mark.parametrize("off_rad", [0.0, 0.002])
def test_proposals_that_end_in_the_same_optimum_are_listed_once(off_rad):
    source, views = window_of("room", 1, 4)
    pose, *_ = pose_of_pair(source.camera, *views[:2])
    near = rotation_from_vector(np.array([0, off_rad, 0])) @ pose.R
    again = Hypothesis(quaternion_from_matrix(near), near, pose.t, pose.inliers)
    found = hypotheses_of(source.camera, views, PRIORS, alternatives=(again, again))
    assert len(found.motions) == 1


@pytest.mark.parametrize("way", ["few tracks", "random pixels"])
def test_a_view_that_cannot_be_located_is_left_out(way):
    source, views = window_of("room", 2, 5)
    lost = views[3]
    if way == "few tracks":
        keep = np.isin(lost.track_ids, np.intersect1d(views[0].track_ids, views[1].track_ids))
        views[3] = lost.at(np.flatnonzero(keep)[:11])
    else:
        pixels = np.random.default_rng(2).uniform((0, 0), (640, 480), lost.pixels.shape)
        views[3] = replace(lost, pixels=pixels, bearings=source.camera.bearings(pixels))
    found = hypotheses_of(source.camera, views, PRIORS)
    assert found.motions[0].rows == (0, 1, 2, 4)
    assert len(found.motions[0].fit.state.R) == 4
    assert len(found.rotation_only.state.R) == 5  # the rotation-only camera sees all views
    assert motion_errors_deg(source, found.motions[0])[1] < 2


# -- motions --------------------------------------------------------------------------------------


def in_another_world(motion: Motion, scale=1.0) -> Motion:
    """The same motion in another frame of reference and another scale."""
    world_from_new = Pose(rotation_from_vector(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, -0.1]))
    scaled = {frame: Pose(pose.R, scale * pose.t) for frame, pose in motion.cam_from_world.items()}
    plane = motion.plane
    if plane is not None:
        turned_plane = world_from_new.R.T @ plane / scale
        plane = turned_plane / (1 - plane / scale @ world_from_new.t)
    return Motion({frame: pose @ world_from_new for frame, pose in scaled.items()}, plane, motion.lens)


@pytest.mark.parametrize("scene", ["room", "wall"])
def test_the_world_and_the_scale_of_a_motion_do_not_matter(scene):
    source, views = window_of(scene, 0, 5, baseline=0.3)
    tracks = gather_tracks(source.camera, views, 0.7)
    motions = motions_of(source.camera, views)
    a, b = (fit_hypotheses(tracks, ones, PRIORS) for ones in (motions, [in_another_world(one, 2.0) for one in motions]))
    assert a.planar == b.planar == (scene == "wall")
    assert len(a.motions) == len(b.motions)
    assert a.motions[0].fit.cost == pytest.approx(b.motions[0].fit.cost, abs=0.5)
    assert a.motions[0].same_as(b.motions[0])


def test_no_motion_has_no_hypotheses():
    source, views = window_of("room", 0, 4)
    tracks = gather_tracks(source.camera, views, 0.7)
    assert fit_hypotheses(tracks, [], PRIORS) is None
    unknown = Motion({100: Pose.identity(), 101: Pose(np.eye(3), np.array([1.0, 0, 0]))})
    assert fit_hypotheses(tracks, [unknown], PRIORS) is None


# -- noise ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", ["room", "wall"])
@pytest.mark.parametrize("stated_px", [0.2, 2.0])
def test_the_noise_is_measured_whatever_was_stated(stated_px, scene):
    source, views = window_of(scene, 0, 6, baseline=0.3, noise_px=0.7)
    assert hypotheses_of(source.camera, views, PRIORS, stated_px).tracks.noise_px == pytest.approx(0.7, rel=0.1)


# -- depth variation ---------------------------------------------------------------------------------------


def test_a_room_that_is_proposed_with_a_plane_is_fitted_without_one():
    source, views = window_of("room", 0, 5)
    motions = motions_of(source.camera, views, kind="planar")
    assert motions[0].plane is not None
    found = fit_hypotheses(gather_tracks(source.camera, views, 0.7), motions, PRIORS)
    assert not found.planar
    assert found.motions[0].fit.state.plane is None
    assert motion_errors_deg(source, found.motions[0])[1] < 2


# -- gain over the rotation-only camera -----------------------------------------------------------


def of_rotation_only_camera(seed, **options):
    """The hypotheses of a sideways translation where the camera only rotates."""
    source, views = window_of("rotation", seed, 6, **options)
    frames = (views[0].frame, views[1].frame)
    sideways = Pose(true_motion(source, *frames).R, np.array([1.0, 0, 0]))
    motion = Motion({frames[0]: Pose.identity(), frames[1]: sideways})
    return fit_hypotheses(gather_tracks(source.camera, views, 0.7), [motion], PRIORS)


def test_twice_the_gain_over_a_rotation_has_its_stated_freedom_where_the_camera_only_rotates():
    z = []
    for seed in range(6):
        gain, freedom = of_rotation_only_camera(seed).gain_over_rotation
        z.append((2 * gain - freedom) / np.sqrt(2 * freedom))
    assert np.mean(z) < 2


def test_a_camera_that_turns_about_several_axes_may_have_another_principal_point():
    options = {"turning_deg_s": 60.0, "noise_px": 0.5, "outliers": 0.1, "principal_error": 0.05}
    source, views = window_of("handheld", 0, 8, **options)
    found = hypotheses_of(source.camera, views, PRIORS, 0.5)
    true, stated = source.sequence.shot.camera, source.camera
    error_px = np.array([true.cx - stated.cx, true.cy - stated.cy])
    assert np.linalg.norm(found.rotation_only.state.lens.principal_px - error_px) < 0.3 * np.linalg.norm(error_px)
    # Without translation, the best motion gains no more than by chance.
    gain, freedom = found.gain_over_rotation
    assert 2 * gain < 1.5 * freedom


# -- the points that a fit hands to the next one --------------------------------------------------


# -- the alignment of a view begins with the proposed rotation -------------------------------------


def test_a_proposal_finds_a_turn_that_is_too_large_for_a_start_without_one():
    rng, turn = np.random.default_rng(0), rotation_from_vector([0.0, 2.5, 0.0])
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (80, 2)), np.ones(80)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    seen, found = np.stack([rays, rays @ turn.T]), np.tile(np.eye(3), (2, 1, 1))
    align_with_first(seen, found)
    assert np.abs(found[1] - turn).max() > 0.1
    found[1] = rotation_from_vector([0.0, 2.4, 0.0])
    align_with_first(seen, found)
    np.testing.assert_allclose(found[1], turn, atol=1e-9)
