"""Operations are counted as the formulas say, and a stage is compared with the nearer limit of the core."""

import numpy as np
import pytest

from tests.benchmarks.speed.operations import (
    bundle_operations,
    elimination_operations,
    flow_operations,
    measured_stages,
    scoring_operations,
    window_operations,
)
from tests.benchmarks.speed.roofline import Limits, Stage, measure_limits, roofline_table

LIMITS = Limits(1e9, {1000: 4e9, 100_000: 1e9})


def test_the_limit_is_the_slower_of_operations_and_memory_with_the_bandwidth_of_the_cache_that_holds_it():
    by_operations = Stage("a", "", 2e6, 1000, 10.0)
    in_small_cache, in_large_cache, in_none = (Stage("b", "", 1.0, touched, 1.0) for touched in (1000, 1001, 1e6))
    assert by_operations.least_ms(LIMITS) == pytest.approx(2.0)
    assert by_operations.bound(LIMITS) == "operations"
    assert in_small_cache.least_ms(LIMITS) == pytest.approx(1e3 * 1000 / 4e9)
    assert in_large_cache.least_ms(LIMITS) == pytest.approx(1e3 * 1001 / 1e9)
    assert in_none.least_ms(LIMITS) == pytest.approx(1e3 * 1e6 / 1e9)
    assert in_none.bound(LIMITS) == "memory"


def test_the_table_tells_what_share_of_the_limit_is_reached():
    table = roofline_table([Stage("stage", "size", 2e6, 1000, 10.0)], LIMITS, 5.0)
    assert "20.0%" in table
    assert "10.000 (2.000)" in table
    assert "2.0000 (operations)" in table


def counted_normal(seen, anchor, lens):
    """Products of a window's common unknowns, one observation after the other: the reference of the largest term."""
    total = 0
    for k, i in zip(*np.nonzero(seen), strict=True):
        if anchor[i] >= 0:
            poses = 0 if k == anchor[i] else int(k > 0) + int(anchor[i] > 0)
            n = 6 * poses + lens
            total += sum(4 * (p + 1) for p in range(n)) + 18 * n
    return total


def test_a_window_counts_each_observation_with_the_poses_that_it_depends_on():
    rng = np.random.default_rng(0)
    seen = rng.uniform(size=(4, 30)) < 0.8
    anchor = np.where(seen.any(axis=0), seen.argmax(axis=0), -1)
    more, fewer = (window_operations(seen, anchor, lens) for lens in (5, 2))
    with_lens = counted_normal(seen, anchor, 5) - counted_normal(seen, anchor, 2) + 12 * 3 * int(seen.sum())
    assert more - fewer == with_lens
    left_out = np.where(np.arange(30) < 10, -1, anchor)
    parts = window_operations(seen[:, :10], anchor[:10], 2) + window_operations(seen, left_out, 2)
    assert parts == pytest.approx(window_operations(seen, anchor, 2))


def test_counts_grow_with_the_size_as_the_formulas_do():
    assert scoring_operations(200) == 2 * scoring_operations(100)
    assert elimination_operations(200, 30) == 2 * elimination_operations(100, 30)
    assert elimination_operations(1, 1000) == pytest.approx(3 * 1000**2, rel=0.01)
    few, many = (flow_operations(64, 48, points, 21, 3, 5) for points in (10, 20))
    assert many - few == 10 * 4 * 441 * (27 + 60)
    assert bundle_operations(4, 300) - bundle_operations(4, 200) == bundle_operations(4, 200) - bundle_operations(
        4, 100
    )


def test_the_core_and_the_stages_are_measured():
    limits = measure_limits()
    assert limits.operations > 1e8
    assert list(limits.bandwidths) == sorted(limits.bandwidths)
    stages = measured_stages(calls=1)
    assert len({stage.name for stage in stages}) == len(stages) == 6
    assert all(stage.operations > 0 and stage.bytes > 0 for stage in stages)
