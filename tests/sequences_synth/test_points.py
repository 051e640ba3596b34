"""Laws of tracks without images: exact ground truth, stated shares, and scenes that are what their name says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences_synth import POINT_SCENES, PointOptions, make_points
from sequences_synth.trajectory import vector_from_rotation

TILTED = {"tilted-15": 15, "tilted-30": 30, "tilted-45": 45}
# Scenes whose camera moves in seconds and does not translate by default.
TIMED = ("handheld", "handheld-wall", "pan")


def reprojected(sequence, index):
    """Pixels of the static points under the true pose."""
    X = (sequence.points - sequence.poses[index, :3, 3]) @ sequence.poses[index, :3, :3]
    return sequence.shot.camera.project(X)


def test_noise_and_shares_are_the_requested_ones():
    sequence = make_points("room", 2, PointOptions(noise_px=0.7, outliers=0.3, moving=0.2, points=2000))
    assert sequence.is_outlier.mean() == pytest.approx(0.3, abs=0.001)
    assert sequence.is_moving.mean() == pytest.approx(0.2, abs=0.001)
    seen = sequence.visible[5] & ~sequence.is_outlier & ~sequence.is_moving
    residuals = (sequence.pixels[5] - reprojected(sequence, 5))[seen]
    assert residuals.std() == pytest.approx(0.7, rel=0.05)


def test_the_path_of_the_camera_has_the_requested_length_or_is_zero():
    for scene in POINT_SCENES:
        sequence = make_points(scene, 3, PointOptions(baseline=0.2))
        steps = np.linalg.norm(np.diff(sequence.poses[:, :3, 3], axis=0), axis=1)
        if scene in ("rotation", "static") or scene in TIMED:
            assert steps.sum() == 0
        else:
            # Bend and tremor make the path longer. The median depth in view differs from that of the whole scene.
            assert 0.1 < steps.sum() / np.nanmedian(sequence.depths(0)) < 0.5


def test_the_points_of_a_planar_scene_lie_on_a_plane_and_others_do_not():
    for scene in ("wall", "nadir", "nadir-turn", *TILTED, "handheld-wall", "handheld", "room"):
        points = make_points(scene, 4).points
        thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2]
        assert thickness > 1 if scene in ("handheld", "room") else thickness < 1e-9


def test_in_a_rotation_scene_the_true_rotation_maps_the_tracks_only_with_the_true_focal_length():
    sequence = make_points("rotation", 3, PointOptions(focal_error=0.05, noise_px=0, outliers=0))
    both = sequence.visible[0] & sequence.visible[-1]
    last_from_first = sequence.poses[-1, :3, :3].T @ sequence.poses[0, :3, :3]

    def largest_error(camera):
        H = camera.K @ last_from_first @ np.linalg.inv(camera.K)
        mapped = np.column_stack([sequence.pixels[0, both], np.ones(both.sum())]) @ H.T
        return np.abs(mapped[:, :2] / mapped[:, 2:] - sequence.pixels[-1, both]).max()

    assert largest_error(sequence.shot.camera) < 1e-9
    assert largest_error(sequence.camera) > 1


@pytest.mark.parametrize("scene", ["room", "static"])
def test_correlated_error_is_the_only_difference_from_the_world_without_it(scene):
    clean, wrong = (make_points(scene, 8, PointOptions(moving=0.2, correlated_px=f, drift_px=2 * f)) for f in (0, 0.5))
    for name in ("poses", "points", "is_outlier", "is_moving", "timestamps_s"):
        np.testing.assert_array_equal(getattr(wrong, name), getattr(clean, name))
    outlier, static = clean.is_outlier, ~(clean.is_outlier | clean.is_moving)
    np.testing.assert_array_equal(wrong.pixels[:, outlier], clean.pixels[:, outlier])
    for index in range(len(clean)):
        seen = static & clean.visible[index]
        expected = wrong.tracking_error.at(index, reprojected(clean, index)[seen])
        np.testing.assert_allclose((wrong.pixels - clean.pixels)[index, seen], expected, atol=1e-9)
    # The tracks of moving objects are real tracks too.
    shift = (wrong.pixels - clean.pixels)[-1, clean.is_moving & clean.visible[-1]]
    assert np.sqrt(np.mean(shift**2)) > 0.2


# -- shutter, hand-held turning, moving objects, lens ----------------------------------------------


EXACT = {"noise_px": 0.0, "outliers": 0.0}


def pixel_poses(shot, tick, pixels):
    """The poses that the camera had when it exposed pixels."""
    return shot.path.at(tick + shot.shutter.delay_s(pixels) / shot.interval_s)


def static_reprojections(sequence, index):
    """Measured pixels of the static tracks of one view, and their projections by the poses of these pixels."""
    ids = np.flatnonzero(sequence.visible[index] & ~sequence.is_outlier & ~sequence.is_moving)
    pixels = sequence.pixels[index, ids]
    poses = pixel_poses(sequence.shot, index, pixels)
    X = np.einsum("ni,nij->nj", sequence.points[ids] - poses[:, :3, 3], poses[:, :3, :3])
    return pixels, sequence.shot.camera.project(X)


@settings(max_examples=40)  # fifteen scenes, four directions
@given(
    seed=st.integers(0, 10**6),
    scene=st.sampled_from(POINT_SCENES),
    readout_ms=st.floats(0, 33),
    direction=st.sampled_from(("down", "up", "right", "left")),
    k1=st.floats(-0.15, 0.3),
)
def test_the_pose_at_the_time_of_its_own_row_projects_each_point_to_its_pixel(seed, scene, readout_ms, direction, k1):
    options = PointOptions(
        **EXACT, views=6, points=60, fps=30, readout_ms=readout_ms, readout_direction=direction, k1=k1,
        speed=0.2, turning_deg_s=90,
    )  # fmt: skip
    sequence = make_points(scene, seed, options)
    for index in range(len(sequence)):
        pixels, projected = static_reprojections(sequence, index)
        np.testing.assert_allclose(projected, pixels, atol=1e-6)


def test_a_turning_camera_keeps_its_number_of_tracks_while_some_leave_and_others_come():
    for scene in TIMED:
        sequence = make_points(scene, 1, PointOptions(views=60, fps=30, turning_deg_s=150.0))
        counts = sequence.visible.sum(axis=1)
        assert counts.mean() == pytest.approx(300, rel=0.15)
        assert counts.min() > 200
        assert (sequence.visible[0] & ~sequence.visible[-1]).sum() > 20
        assert (sequence.visible[-1] & ~sequence.visible[0]).sum() > 20


@pytest.mark.parametrize(("moving", "objects"), [(0.6, 1), (0.5, 2), (0.3, 3)])
def test_the_moving_objects_have_their_share_of_the_tracks_and_move_rigidly(moving, objects):
    options = PointOptions(**EXACT, moving=moving, objects=objects, object_deg_s=20, points=600, baseline=0.2)
    sequence = make_points("room", 6, options)
    assert sequence.is_moving.mean() == pytest.approx(moving, abs=0.002)
    np.testing.assert_array_equal(sequence.is_moving, sequence.shot.objects.object_of_track >= 0)
    for label in range(objects):
        own = sequence.shot.objects.object_of_track == label
        assert own.mean() == pytest.approx(moving / objects, abs=0.002)
        before = sequence.points[own]
        after = sequence.shot.objects.displaced(sequence.points, 1.0)[own]
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
        np.testing.assert_allclose(sequence.shot.camera.project(X), sequence.pixels[-1, own][seen], atol=1e-9)
