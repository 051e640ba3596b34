"""Laws of fundamental matrices and homographies: they fit exact matches exactly."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from make_model_views import estimate, views

from slam_init.methods.models import (
    epipolar_errors,
    fundamental_eight_point,
    homography_dlt,
    normalize,
    normalizing_transform,
    sampson_errors,
    transfer_errors,
)


@given(st.integers(0, 10_000), st.integers(8, 30))
def test_a_fundamental_matrix_has_rank_two_and_fits_exact_matches(seed, count):
    pixels1, pixels2, _ = views(seed, count)
    F = estimate(fundamental_eight_point, pixels1, pixels2, "transpose")
    assert max(e.max() for e in epipolar_errors(F, pixels1, pixels2)) < 1e-6
    assert sampson_errors(F, pixels1, pixels2).max() < 1e-6
    assert abs(np.linalg.det(F[0] / np.linalg.norm(F[0]))) < 1e-12


@given(st.integers(0, 10_000), st.integers(4, 30))
def test_a_homography_fits_an_exact_plane(seed, count):
    pixels1, pixels2, _ = views(seed, count, planar=True)
    H = estimate(homography_dlt, pixels1, pixels2, "inverse")
    assert max(e.max() for e in transfer_errors(H, pixels1, pixels2)) < 1e-4


@given(st.integers(0, 10_000))
def test_normalized_pixels_have_mean_zero_and_mean_absolute_coordinates_of_one(seed):
    pixels = np.random.default_rng(seed).uniform((0, 0), (640, 480), (20, 2))
    normalized = normalize(normalizing_transform(pixels), pixels)
    np.testing.assert_allclose(normalized.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.abs(normalized).mean(axis=0), 1)


def test_a_singular_homography_raises_no_warning():
    pixels1, pixels2, _ = views(0)
    in2, in1 = transfer_errors(np.zeros((1, 3, 3)), pixels1, pixels2)
    assert not np.isfinite(in2).any()
    assert not np.isfinite(in1).any()
