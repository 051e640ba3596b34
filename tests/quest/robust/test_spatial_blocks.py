"""Laws of regions of the view: sums over regions scatter more if neighbours agree."""

import numpy as np
import pytest

from quest.robust.spatial_blocks import regions_of, scatter_of_sum


def test_a_sum_of_votes_that_agree_within_regions_scatters_more():
    rng = np.random.default_rng(0)
    where = rng.uniform(-1, 1, (4800, 2))
    region = regions_of(where)
    assert len(np.unique(region)) == 48
    assert (np.abs(np.bincount(region) - 100) < 50).all()
    single = rng.choice([-1.0, 1.0], 4800)
    by_region = rng.choice([-1.0, 1.0], 48)[region]
    assert scatter_of_sum(single, where) == pytest.approx(np.sqrt(4800), rel=0.2)
    assert scatter_of_sum(by_region, where) > 5 * np.sqrt(4800)
    assert scatter_of_sum(np.zeros(4800), where) == 0
    assert scatter_of_sum(np.zeros(0), np.zeros((0, 2))) == 0
