"""The number of samples that a search needs, and how they are drawn."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quest.robust.samples import draw_samples, samples_needed

SEEDS = st.integers(0, 2**32 - 1)


# --- samples_needed ---


def test_the_number_of_samples_is_that_of_the_textbook():
    # Hartley and Zisserman, table 4.3, p = 0.99: samples of 7, 50 % outliers -> 588; samples of 2, 20 % -> 5.
    assert math.ceil(samples_needed(0.5, 7, 0.99, 1.0)) == 588
    assert math.ceil(samples_needed(0.8, 2, 0.99, 1.0)) == 5


# --- draw_samples ---


@given(seed=SEEDS, size=st.integers(1, 7), surplus=st.integers(0, 60), batch=st.integers(1, 40))
def test_samples_hold_distinct_indices(seed, size, surplus, batch):
    count = size + surplus
    samples = draw_samples(np.random.default_rng(seed), count, size, batch)
    assert samples.shape == (batch, size)
    assert samples.min() >= 0
    assert samples.max() < count
    assert all(len(set(row)) == size for row in samples.tolist())


@pytest.mark.parametrize("count", [5, 9], ids=["few data: by shuffling", "many data: by rejection"])
def test_every_subset_is_drawn_equally_often(count):
    subsets = dict.fromkeys(combinations(range(count), 2), 0)
    draws = 400 * len(subsets)
    for row in np.sort(draw_samples(np.random.default_rng(3), count, 2, draws), axis=1).tolist():
        subsets[tuple(row)] += 1
    # Each count has mean 400 and standard deviation 20; the bound is five deviations.
    assert min(subsets.values()) > 300
    assert max(subsets.values()) < 500
