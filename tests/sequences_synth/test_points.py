"""Laws of tracks without images: exact ground truth, stated shares, and scenes that are what their name says."""

import numpy as np
import pytest

from sequences_synth import POINT_SCENES, SCENES_WITHOUT_TRANSLATION, PointOptions, make_points


def reprojected(sequence, index):
    """Pixels of the static points under the true pose."""
    X = (sequence.points - sequence.poses[index, :3, 3]) @ sequence.poses[index, :3, :3]
    return X[:, :2] / X[:, 2:] * sequence.true_camera.fx + [sequence.true_camera.cx, sequence.true_camera.cy]


@pytest.mark.parametrize("scene", POINT_SCENES)
def test_without_noise_static_points_project_exactly_to_their_pixels(scene):
    sequence = make_points(scene, 1, PointOptions(noise_px=0, outliers=0.2, moving=0.2))
    static = ~(sequence.is_outlier | sequence.is_moving)
    for index in range(len(sequence)):
        seen = sequence.visible[index] & static
        assert seen.sum() > 50
        np.testing.assert_allclose(sequence.pixels[index, seen], reprojected(sequence, index)[seen], atol=1e-9)
        assert (sequence.depths(index)[seen] > 0).all()


def test_noise_and_shares_are_the_requested_ones():
    sequence = make_points("room", 2, PointOptions(noise_px=0.7, outliers=0.3, moving=0.2, points=2000))
    assert sequence.is_outlier.mean() == pytest.approx(0.3, abs=0.001)
    assert sequence.is_moving.mean() == pytest.approx(0.2, abs=0.001)
    seen = sequence.visible[5] & ~sequence.is_outlier & ~sequence.is_moving
    residuals = (sequence.pixels[5] - reprojected(sequence, 5))[seen]
    assert residuals.std() == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("scene", POINT_SCENES)
def test_the_path_of_the_camera_has_the_requested_length_or_is_zero(scene):
    sequence = make_points(scene, 3, PointOptions(baseline=0.2))
    steps = np.linalg.norm(np.diff(sequence.poses[:, :3, 3], axis=0), axis=1)
    if scene in SCENES_WITHOUT_TRANSLATION:
        assert steps.sum() == 0
    else:
        # Bend and tremor make the path longer. The median depth in view differs from that of the whole scene.
        assert 0.1 < steps.sum() / np.nanmedian(sequence.depths(0)) < 0.5


@pytest.mark.parametrize("scene", ["wall", "nadir", "nadir-turn"])
def test_the_points_of_a_planar_scene_lie_on_a_plane(scene):
    points = make_points(scene, 4).points
    assert np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < 1e-9


def test_equal_seeds_give_equal_sequences_and_different_seeds_different_ones():
    a, b, c = (make_points("desk", seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.pixels, b.pixels)
    assert a.pixels.shape != c.pixels.shape or not np.allclose(a.pixels, c.pixels)


def test_focal_error_changes_only_the_stated_focal_length():
    right, wrong = (make_points("room", 7, PointOptions(focal_error=error)) for error in (0.0, 0.05))
    np.testing.assert_array_equal(right.pixels, wrong.pixels)
    assert wrong.camera.fx == pytest.approx(1.05 * right.camera.fx)
