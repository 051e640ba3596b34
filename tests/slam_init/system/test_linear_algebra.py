"""Deviations of covariances: what is no covariance has none."""

import numpy as np
import pytest

from slam_init.system.linear_algebra import deviations


def test_variances_have_their_roots_and_rounding_is_zero():
    np.testing.assert_array_equal(deviations(np.array([[-1e-9, 4.0], [0.0, 0.0]])), [[0.0, 2.0], [0.0, 0.0]])


@pytest.mark.parametrize("variances", [[-1.0, 2.0], [-3.0, -2.0], [np.nan, 1.0]])
def test_a_negative_variance_is_a_refusal_and_no_certainty(variances):
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        deviations(np.array(variances))
