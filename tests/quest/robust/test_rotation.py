"""The rotation that explains most matches: proposed by pairs of matches, compiled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import NOISE_RAD, THRESHOLD_RAD, angle_between, assert_orthonormal, rotated
from make_views import unit

from quest.robust import kernels
from quest.robust.rotation import fit_rotation, propose_rotation

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


@laws
@given(seed=SEEDS, count=st.sampled_from([20, 150, 151, 500]), wrong_share=st.sampled_from([0.0, 0.5, 0.7]))
def test_the_proposed_rotation_is_near_that_of_all_matches(seed, count, wrong_share):
    R, m, n = rotated(seed, count, int(wrong_share * count))
    proposed = propose_rotation(m, n, THRESHOLD_RAD, np.random.default_rng(seed))
    fitted, r2 = fit_rotation(m, n, THRESHOLD_RAD, np.random.default_rng(seed))
    assert_orthonormal(proposed)
    # Six matches at the least, a field of view of half a radian, and noise in each.
    assert angle_between(proposed, R) < 20 * NOISE_RAD
    assert angle_between(fitted, R) < 20 * NOISE_RAD
    assert r2 == pytest.approx(0.5 * np.sum((n - m @ fitted.T) ** 2, axis=1))


def test_equal_and_opposite_rays_determine_no_rotation():
    uniform, found = np.random.default_rng(0).random((50, 2)), np.empty((3, 3))
    ray = unit(np.array([0.1, -0.2, 1.0]))
    m = ray * np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    assert not kernels.best_rotation(m, m, uniform, THRESHOLD_RAD, 1e-6, found)
    R = propose_rotation(m, m, THRESHOLD_RAD, np.random.default_rng(0))
    assert_orthonormal(R)
    assert R @ ray == pytest.approx(ray, abs=1e-6)
