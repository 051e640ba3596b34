"""Laws of tracks without images: exact truth, stated shares, scenes as named."""

import numpy as np
import pytest

from sequences_synth import POINT_SCENES, STILL_SCENES, PointOptions, make_points
from slam_init.datasets.points import open_points
from slam_init.errors import SourceError


def reprojected(sequence, index):
    """Pixels of the points at rest under the true pose."""
    X = (sequence.points - sequence.poses[index, :3, 3]) @ sequence.poses[index, :3, :3]
    return X[:, :2] / X[:, 2:] * sequence.true_camera.fx + [sequence.true_camera.cx, sequence.true_camera.cy]


@pytest.mark.parametrize("scene", POINT_SCENES)
def test_without_noise_the_truth_explains_what_is_at_rest(scene):
    sequence = make_points(scene, 1, PointOptions(noise_px=0, outliers=0.2, moving=0.2))
    rest = ~(sequence.wrong | sequence.moving)
    for index in range(len(sequence)):
        seen = sequence.visible[index] & rest
        assert seen.sum() > 50
        np.testing.assert_allclose(sequence.pixels[index, seen], reprojected(sequence, index)[seen], atol=1e-9)
        assert (sequence.depths(index)[seen] > 0).all()


def test_noise_and_shares_are_those_that_were_asked_for():
    sequence = make_points("room", 2, PointOptions(noise_px=0.7, outliers=0.3, moving=0.2, points=2000))
    assert sequence.wrong.mean() == pytest.approx(0.3, abs=0.001)
    assert sequence.moving.mean() == pytest.approx(0.2, abs=0.001)
    seen = sequence.visible[5] & ~sequence.wrong & ~sequence.moving
    residuals = (sequence.pixels[5] - reprojected(sequence, 5))[seen]
    assert residuals.std() == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("scene", POINT_SCENES)
def test_the_camera_goes_as_far_as_was_asked_for_or_not_at_all(scene):
    sequence = make_points(scene, 3, PointOptions(baseline=0.2))
    steps = np.linalg.norm(np.diff(sequence.poses[:, :3, 3], axis=0), axis=1)
    if scene in STILL_SCENES:
        assert steps.sum() == 0
    else:
        # a bend and a tremor make the way longer; of a half-cut view the median depth differs
        assert 0.1 < steps.sum() / np.nanmedian(sequence.depths(0)) < 0.5


@pytest.mark.parametrize("scene", ["wall", "nadir", "nadir-turn"])
def test_planes_are_flat(scene):
    points = make_points(scene, 4).points
    assert np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < 1e-9


def test_the_same_seed_is_the_same_sequence_and_another_is_another():
    a, b, c = (make_points("desk", seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.pixels, b.pixels)
    assert a.pixels.shape != c.pixels.shape or not np.allclose(a.pixels, c.pixels)


def test_a_wrong_focal_length_is_stated_and_not_used():
    right, wrong = (make_points("room", 7, PointOptions(focal_error=error)) for error in (0.0, 0.05))
    np.testing.assert_array_equal(right.pixels, wrong.pixels)
    assert wrong.camera.fx == pytest.approx(1.05 * right.camera.fx)


@pytest.mark.parametrize(
    "text", ["points:attic", "points:room?colour=1", "points:room?views=many", "points:room?outliers=2"]
)
def test_what_cannot_be_made_is_told_in_one_line(text):
    with pytest.raises(SourceError) as caught:
        open_points(text, 0)
    assert "\n" not in str(caught.value)
