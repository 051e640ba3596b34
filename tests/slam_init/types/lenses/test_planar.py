"""The radial-tangential lens: its compiled inverse against that of all lenses in numpy."""

import numpy as np
import pytest

from slam_init.types.lenses.lens import Bending, RadialTangentialLens


@pytest.mark.parametrize(
    "coefficients",
    [(-0.28, 0.07, 2e-4, 2e-5), (0.26, -0.95, -5e-3, 2.6e-3, 1.16), (-0.36, 0.0, 0.0, 0.0), (0.1, 0.0, 0.01, -0.02)],
)
def test_the_compiled_inverse_is_the_readable_one(coefficients):
    """Also for points without a ray, beyond the radius at which the image stops growing, and far beyond it."""
    lens, rng = RadialTangentialLens(coefficients), np.random.default_rng(0)
    k1, k2, p1, p2, k3 = (*coefficients, 0.0)[:5]
    distorted = np.vstack([rng.uniform(-1.2, 1.2, (400, 2)), [[0.0, 0.0], [40.0, -3.0], [np.nan, 0.1], [np.inf, 0.0]]])
    found = lens.undistort(distorted)
    with_ray = np.isfinite(found).all(axis=1)
    with np.errstate(all="ignore"):  # points without a ray
        expected = Bending(k1, k2, k3, p1=p1, p2=p2).invert(distorted, min(lens.max_tangent, 60.0))
        solved = np.abs(lens.distort(expected) - distorted).max(axis=1) < 1e-10
    np.testing.assert_array_equal(with_ray, solved & lens.sees(expected))
    np.testing.assert_allclose(found[with_ray], expected[with_ray], rtol=1e-9, atol=1e-12)
    assert with_ray.sum() > 50


def test_no_points_and_views_of_arrays_are_undistorted():
    lens, three = RadialTangentialLens((-0.28, 0.07, 0.0, 0.0)), np.random.default_rng(1).uniform(-0.4, 0.4, (9, 3))
    three.setflags(write=False)
    np.testing.assert_array_equal(lens.undistort(three[:, :2]), lens.undistort(three[:, :2].copy()))
    assert lens.undistort(np.zeros((0, 2))).shape == (0, 2)
