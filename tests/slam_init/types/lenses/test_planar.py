"""The radial-tangential lens: its compiled inverse against its formula."""

import numpy as np
import pytest

from slam_init.types.lenses.lens import lens_of


@pytest.mark.parametrize(
    "coefficients",
    [(-0.28, 0.07, 2e-4, 2e-5), (0.26, -0.95, -5e-3, 2.6e-3, 1.16), (-0.36, 0.0, 0.0, 0.0), (0.1, 0.0, 0.01, -0.02)],
)
def test_the_compiled_inverse_is_that_of_the_formula(coefficients):
    """Also for places without a ray; those beyond the radius at which the image stops growing are in test_camera."""
    lens, rng = lens_of("radtan", coefficients, is_planar=True), np.random.default_rng(0)
    inner = rng.uniform(-0.5, 0.5, (400, 2))
    distorted = lens.bending.apply(inner[np.linalg.norm(inner, axis=1) < lens.largest_radius])
    found = lens.undistort(np.vstack([distorted, [[40.0, -3.0], [np.nan, 0.1], [np.inf, 0.0]]]))
    np.testing.assert_allclose(lens.bending.apply(found[:-3]), distorted, rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(found[:-3], axis=1).max() <= lens.largest_radius
    assert np.isnan(found[-2:]).all()


def test_no_points_and_views_of_arrays_are_undistorted():
    lens = lens_of("radtan", (-0.28, 0.07, 0.0, 0.0), is_planar=True)
    three = np.random.default_rng(1).uniform(-0.4, 0.4, (9, 3))
    three.setflags(write=False)
    np.testing.assert_array_equal(lens.undistort(three[:, :2]), lens.undistort(three[:, :2].copy()))
    assert lens.undistort(np.zeros((0, 2))).shape == (0, 2)
