"""Laws of the largest cost of a track that a map explains."""

import numpy as np
import pytest

from slam_init.window.equations import explained_at_most


@pytest.mark.parametrize("freedom", [1, 5, 9, 21])
def test_hardly_any_correct_track_exceeds_the_largest_explained_cost(freedom):
    costs = np.random.default_rng(0).chisquare(freedom, 100_000)
    limit = explained_at_most(np.array(freedom))
    assert np.mean(costs > limit) < 0.005
    assert freedom < limit < explained_at_most(np.array(freedom + 1))


def test_a_track_without_freedom_has_no_cost():
    assert explained_at_most(np.array([0])) == 0
