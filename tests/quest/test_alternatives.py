"""Comparison of two motions: how many matches that only one of them explains decide between the two."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quest.alternatives import decides
from quest.robust.spatial_blocks import scatter_of_sum


@given(a=st.integers(0, 500), b=st.integers(0, 500), total=st.integers(0, 1000))
def test_votes_decide_for_at_most_one_side(a, b, total):
    assert not (decides(a, b, total) and decides(b, a, total))


@given(a=st.integers(0, 500), b=st.integers(1, 500), total=st.integers(0, 1000))
def test_a_vote_against_never_helps(a, b, total):
    assert decides(a, b - 1, total) or not decides(a, b, total)


@pytest.mark.parametrize(
    ("votes_for", "votes_against", "total", "decided"),
    [
        (16, 0, 100, True),
        (15, 0, 100, False),  # four deviations of 15 coins are 15.5
        (200, 150, 400, False),  # 2.7 deviations
        (200, 100, 400, True),  # 5.8 deviations
        (29, 0, 1000, False),  # a small moving object of 3 %
        (30, 0, 1000, True),
    ],
)
def test_the_number_of_votes_that_decides(votes_for, votes_against, total, decided):
    assert decides(votes_for, votes_against, total) is decided


def test_votes_from_a_single_region_do_not_decide():
    """The votes of a moving body or of a repeated texture are correlated."""
    rng = np.random.default_rng(0)
    where = rng.uniform(-1, 1, (600, 2))
    spread = np.zeros(600)
    spread[::12] = 1.0
    corner = np.where(np.argsort(np.argsort(np.linalg.norm(where + 1, axis=1))) < 50, 1.0, 0.0)
    assert spread.sum() == corner.sum() == 50
    assert decides(50, 0, 600, scatter_of_sum(spread, where))
    assert not decides(50, 0, 600, scatter_of_sum(corner, where))
