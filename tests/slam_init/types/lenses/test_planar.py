"""The radial-tangential lens: its compiled inverse against the same in numpy."""

import numpy as np
import pytest

from slam_init.types.lenses.lens import RadialTangentialLens


def readable_undistort(lens, distorted):
    """Newton's method for all points at once, from the distorted ones."""
    k1, k2, p1, p2, k3 = (*lens.coefficients, 0.0)[:5]
    xy = distorted
    with np.errstate(all="ignore"):
        for _ in range(30):
            x, y = xy.T
            left_x, left_y = (lens.distort(xy) - distorted).T
            r2 = x * x + y * y
            radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
            jxx, jyy = (
                radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
                radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
            )
            jxy = x * y * slope + 2 * p1 * x + 2 * p2 * y
            step = np.column_stack([jyy * left_x - jxy * left_y, jxx * left_y - jxy * left_x])
            xy = xy - step / (jxx * jyy - jxy * jxy)[:, None]
        solved = np.abs(lens.distort(xy) - distorted).max(axis=1, initial=0.0) < 1e-10
        return np.where((solved & lens.sees(xy))[:, None], xy, np.nan)


@pytest.mark.parametrize(
    "coefficients",
    [(-0.28, 0.07, 2e-4, 2e-5), (0.26, -0.95, -5e-3, 2.6e-3, 1.16), (-0.36, 0.0, 0.0, 0.0), (0.1, 0.0, 0.01, -0.02)],
)
def test_the_compiled_inverse_is_the_readable_one(coefficients):
    """Also for points without a ray, beyond the radius at which the image stops growing, and far beyond it."""
    lens, rng = RadialTangentialLens(coefficients), np.random.default_rng(0)
    distorted = np.vstack([rng.uniform(-1.2, 1.2, (400, 2)), [[0.0, 0.0], [40.0, -3.0], [np.nan, 0.1], [np.inf, 0.0]]])
    found, expected = lens.undistort(distorted), readable_undistort(lens, distorted)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    assert np.isfinite(found).all(axis=1).sum() > 50


def test_no_points_and_views_of_arrays_are_undistorted():
    lens, three = RadialTangentialLens((-0.28, 0.07, 0.0, 0.0)), np.random.default_rng(1).uniform(-0.4, 0.4, (9, 3))
    three.setflags(write=False)
    np.testing.assert_array_equal(lens.undistort(three[:, :2]), lens.undistort(three[:, :2].copy()))
    assert lens.undistort(np.zeros((0, 2))).shape == (0, 2)
