"""The alignment of views finds their rotations, among outliers and beside missing tracks."""

import numpy as np
import pytest

from quest.geometry.quaternion import rotation_from_vector
from slam_init.window.locating import align_with_first


def views_of(seed, outliers, *, tracks=80, views=4, largest_rad=0.5):
    """Rays (V, T, 3) of a camera that rotates, with outliers and missing rays, and its rotations."""
    rng = np.random.default_rng(seed)
    R = np.array(
        [np.eye(3), *(rotation_from_vector(largest_rad * rng.uniform(-0.5, 0.5, 3)) for _ in range(views - 1))]
    )
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (tracks, 2)), np.ones(tracks)])
    seen = rays @ np.swapaxes(R, 1, 2) + 1e-3 * rng.normal(size=(views, tracks, 3))
    wrong = rng.random((views, tracks)) < outliers
    wrong[0] = False
    seen[wrong] = [0, 0, 1] + 0.4 * rng.normal(size=(wrong.sum(), 3))
    seen /= np.linalg.norm(seen, axis=2, keepdims=True)
    seen[rng.random((views, tracks)) < 0.2] = np.nan
    return seen, R


@pytest.mark.parametrize("outliers", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(2))
def test_the_rotations_are_near_the_true_ones(seed, outliers):
    rays, true = views_of(seed, outliers)
    proposal = rotation_from_vector([0.02, 0.01, 0.0]) @ true[1]
    found = np.tile(proposal, (len(rays), 1, 1))
    align_with_first(rays, found)
    np.testing.assert_allclose(found, true, atol=3e-3)


def test_a_proposal_finds_a_turn_that_is_too_large_for_a_start_without_one():
    rays, _ = views_of(0, 0.0, views=2)
    turn = rotation_from_vector([0.0, 2.5, 0.0])
    rays[1] = rays[0] @ turn.T
    found = np.tile(np.eye(3), (2, 1, 1))
    align_with_first(rays, found)
    assert np.abs(found[1] - turn).max() > 0.1
    found[1] = rotation_from_vector([0.0, 2.4, 0.0])
    align_with_first(rays, found)
    np.testing.assert_allclose(found[1], turn, atol=1e-9)


def test_a_view_with_too_few_common_tracks_has_no_rotation():
    rays, _ = views_of(1, 0.0)
    rays[2, 2:] = np.nan
    found = np.tile(rotation_from_vector([0.1, 0, 0]), (len(rays), 1, 1))
    align_with_first(rays, found)
    np.testing.assert_array_equal(found[2], np.eye(3))
