"""Laws of point worlds with shutter, hand-held turning, bodies, calibration errors and cuts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences_synth import POINT_SCENES, PointOptions, make_points
from sequences_synth.trajectory import vector_from_rotation

EXACT = {"noise_px": 0.0, "outliers": 0.0}
TURNING = ("handheld", "handheld-wall", "pan")


def static_reprojections(sequence, index):
    """Measured pixels of the static tracks of one view, and their projections by the poses of these pixels."""
    ids = np.flatnonzero(sequence.visible[index] & ~sequence.is_outlier & ~sequence.is_moving)
    pixels = sequence.pixels[index, ids]
    poses = sequence.pixel_poses(index, pixels)
    X = np.einsum("ni,nij->nj", sequence.points[ids] - poses[:, :3, 3], poses[:, :3, :3])
    return pixels, sequence.true_camera.project(X), X[:, 2]


@settings(max_examples=40)  # fifteen scenes, four directions
@given(
    seed=st.integers(0, 10**6),
    scene=st.sampled_from(POINT_SCENES),
    readout_ms=st.floats(0, 33),
    direction=st.sampled_from(("down", "up", "right", "left")),
    k1=st.floats(-0.15, 0.3),
    cut=st.sampled_from([0, 3]),
)
def test_the_pose_at_the_time_of_its_own_row_projects_each_point_to_its_pixel(
    seed, scene, readout_ms, direction, k1, cut
):
    options = PointOptions(
        **EXACT, views=6, points=60, fps=30, readout_ms=readout_ms, readout_direction=direction, k1=k1, cut=cut,
        speed=0.2, turning_deg_s=90,
    )  # fmt: skip
    sequence = make_points(scene, seed, options)
    for index in range(len(sequence)):
        pixels, projected, _ = static_reprojections(sequence, index)
        np.testing.assert_allclose(projected, pixels, atol=1e-6)


def test_the_pose_of_a_frame_is_that_of_its_middle_row():
    sequence = make_points("handheld", 1, PointOptions(fps=30, readout_ms=30, speed=0.2))
    middle = sequence.pixel_poses(4, np.array([[0.0, 240.0], [639.0, 240.0], [320.0, 0.0]]))
    np.testing.assert_allclose(middle[:2], np.stack(2 * [sequence.poses[4]]), atol=1e-12)
    assert np.abs(middle[2] - sequence.poses[4]).max() > 1e-3


def test_a_turning_camera_keeps_its_number_of_tracks_while_some_leave_and_others_come():
    for scene in TURNING:
        sequence = make_points(scene, 1, PointOptions(views=60, fps=30, turning_deg_s=150.0))
        counts = sequence.visible.sum(axis=1)
        assert counts.mean() == pytest.approx(300, rel=0.15)
        assert counts.min() > 200
        assert (sequence.visible[0] & ~sequence.visible[-1]).sum() > 20
        assert (sequence.visible[-1] & ~sequence.visible[0]).sum() > 20


def test_a_hand_held_camera_translates_by_the_requested_share_of_the_depth():
    for scene, seed in (("handheld", 0), ("handheld-wall", 1)):
        sequence = make_points(scene, seed, PointOptions(views=40, fps=30, speed=0.25, points=1000))
        steps = np.linalg.norm(np.diff(sequence.poses[:, :3, 3], axis=0), axis=1)
        depth = np.nanmedian(sequence.depths(0)[sequence.visible[0]])
        assert steps.sum() * 30 / 39 / depth == pytest.approx(0.25, rel=0.25)


def test_the_points_of_a_hand_held_wall_lie_on_a_plane_and_those_of_a_hand_held_room_do_not():
    flat, deep = (
        np.linalg.svd((p := make_points(scene, 4).points) - p.mean(axis=0), compute_uv=False)[2]
        for scene in ("handheld-wall", "handheld")
    )
    assert flat < 1e-9 < 1 < deep


@pytest.mark.parametrize(("moving", "bodies"), [(0.6, 1), (0.5, 2), (0.3, 3)])
def test_the_bodies_have_their_share_of_the_tracks_and_move_rigidly(moving, bodies):
    options = PointOptions(**EXACT, moving=moving, bodies=bodies, body_turn_deg_s=20, points=600, baseline=0.2)
    sequence = make_points("room", 6, options)
    assert sequence.is_moving.mean() == pytest.approx(moving, abs=0.002)
    np.testing.assert_array_equal(sequence.is_moving, sequence.body_of_track >= 0)
    (shot,) = sequence.shots
    for body in range(bodies):
        own = sequence.body_of_track == body
        assert own.mean() == pytest.approx(moving / bodies, abs=0.002)
        before = sequence.points[own]
        after = shot.bodies.displaced(sequence.points, 1.0)[own]
        # 1.1 s at 20 deg/s about the centre, which translates.
        centred = [X - X.mean(axis=0) for X in (before, after)]
        left, _, right = np.linalg.svd(centred[0].T @ centred[1])
        R = (left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right).T
        np.testing.assert_allclose(centred[0] @ R.T, centred[1], atol=1e-9)
        assert np.degrees(np.linalg.norm(vector_from_rotation(R))) == pytest.approx(22)
        moved = np.linalg.norm((after - before).mean(axis=0))
        assert 0.4 < moved / (0.2 * np.nanmedian(sequence.depths(0))) < 2
        # The measured pixels show the moved points.
        pose, seen = sequence.poses[-1], sequence.visible[-1][own]
        X = (after[seen] - pose[:3, 3]) @ pose[:3, :3]
        np.testing.assert_allclose(sequence.true_camera.project(X), sequence.pixels[-1, own][seen], atol=1e-9)


def test_a_body_is_compact_in_the_first_view():
    sequence = make_points("room", 7, PointOptions(moving=0.3, bodies=1))
    direction = sequence.points / np.linalg.norm(sequence.points, axis=1, keepdims=True)
    centre = direction[sequence.is_moving].mean(axis=0)
    cosine = direction @ centre / np.linalg.norm(centre)
    assert np.median(cosine[sequence.is_moving]) > np.quantile(cosine[~sequence.is_moving], 0.9)


def test_a_lens_moves_the_pixels_away_from_the_centre_and_the_stated_camera_lacks_it():
    k1 = 0.2
    sequence = make_points("static", 1, PointOptions(**EXACT, k1=k1))
    assert sequence.camera.k1 == 0 and sequence.true_camera.k1 == k1
    X = sequence.points[sequence.visible[0]]
    ideal = X[:, :2] / X[:, 2:]
    seen = (sequence.pixels[0, sequence.visible[0]] - [319.5, 239.5]) / 458
    np.testing.assert_allclose(seen, ideal * (1 + k1 * np.sum(ideal**2, axis=1, keepdims=True)), atol=1e-9)


def test_after_a_cut_all_tracks_are_new_and_the_truth_is_that_of_the_second_scene():
    sequence = make_points("wall", 3, PointOptions(**EXACT, views=10, cut=4))
    before, after = sequence.visible[:4].any(axis=0), sequence.visible[4:].any(axis=0)
    assert before.any() and after.any() and not (before & after).any()
    np.testing.assert_array_equal(sequence.scene_of_track[after], 1)
    for index in range(10):
        pixels, projected, depth = static_reprojections(sequence, index)
        assert len(pixels) > 100
        np.testing.assert_allclose(projected, pixels, atol=1e-9)
        own = sequence.depths(index)[sequence.visible[index]]
        np.testing.assert_allclose(own, depth)
        assert np.isnan(sequence.depths(index)[sequence.visible[(index + 5) % 10]]).all() == (
            (index < 4) != ((index + 5) % 10 < 4)
        )
    assert np.abs(sequence.poses[4] - sequence.poses[3]).max() > 1e-3
    np.testing.assert_allclose(np.diff(sequence.timestamps_s), 0.1)
