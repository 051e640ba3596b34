"""Laws of the tails: they are those of chi-square, and a statistic exceeds a level at any look at most so often."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from slam_init.window.equations import explained_at_most
from slam_init.window.uncertainty import at_any_time, chi_square_as_gaussian, three_directions, two_directions


@pytest.mark.parametrize("limit", [0.5, 1.5, 3.0])
def test_an_error_in_two_or_three_directions_exceeds_a_limit_as_often_as_simulated_errors_do(limit):
    errors = np.random.default_rng(1).normal(size=(200_000, 3))
    assert two_directions(limit, np.ones(1))[0] == pytest.approx(
        (np.linalg.norm(errors[:, :2], axis=1) > limit).mean(), abs=0.004
    )
    assert three_directions(limit, 1.0) == pytest.approx((np.linalg.norm(errors, axis=1) > limit).mean(), abs=0.004)


@pytest.mark.parametrize("z", [2.0, 2.5, 3.0])
def test_a_statistic_that_is_looked_at_often_exceeds_a_level_at_most_as_often_as_stated(z):
    """The information grows a hundredfold, by a half from look to look."""
    rng = np.random.default_rng(2)
    information = np.minimum(1.5 ** np.arange(13), 100.0)
    steps = rng.normal(size=(100_000, len(information))) * np.sqrt(np.diff(information, prepend=0.0))
    statistics = np.cumsum(steps, axis=1) / np.sqrt(information)
    exceeded = (statistics > z).any(axis=1).mean()
    assert (statistics[:, -1] > z).mean() < exceeded <= at_any_time(z)


@pytest.mark.parametrize("freedom", [2.5, 8.5, 32.5])
def test_chi_square_as_gaussian_has_the_tails_of_chi_square(freedom):
    levels = np.array([0.5, 0.05, 1e-3, 1e-5])
    found = chi_square_as_gaussian(chi2.isf(levels, freedom) / freedom, freedom)
    assert found == pytest.approx(norm.isf(levels), abs=0.2)


# -- the largest cost of a track that a map explains ----------------------------------------------


@pytest.mark.parametrize("freedom", [1, 5, 9, 21])
def test_hardly_any_correct_track_exceeds_the_largest_explained_cost(freedom):
    costs = np.random.default_rng(0).chisquare(freedom, 100_000)
    limit = explained_at_most(np.array(freedom))
    assert np.mean(costs > limit) < 0.005
    assert freedom < limit < explained_at_most(np.array(freedom + 1))
