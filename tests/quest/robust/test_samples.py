"""The number of samples that a search needs, and how they are chosen."""

import math
from itertools import combinations

import numpy as np
import pytest

from quest.robust.samples import draw_samples, samples_needed

# --- samples_needed ---


def test_the_number_of_samples_is_that_of_the_textbook():
    # Hartley and Zisserman, table 4.3, p = 0.99: samples of 7, 50 % outliers -> 588; samples of 2, 20 % -> 5.
    assert math.ceil(samples_needed(0.5, 7, 0.99, 1.0)) == 588
    assert math.ceil(samples_needed(0.8, 2, 0.99, 1.0)) == 5


# --- draw_samples ---


@pytest.mark.parametrize("count", [5, 9], ids=["few data: by shuffling", "many data: by rejection"])
def test_every_subset_is_drawn_equally_often(count):
    subsets = dict.fromkeys(combinations(range(count), 2), 0)
    draws = 400 * len(subsets)
    for row in np.sort(draw_samples(np.random.default_rng(3), count, 2, draws), axis=1).tolist():
        subsets[tuple(row)] += 1
    # Each count has mean 400 and standard deviation 20; the bound is five deviations.
    assert min(subsets.values()) > 300
    assert max(subsets.values()) < 500
