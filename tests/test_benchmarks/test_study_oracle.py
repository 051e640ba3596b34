"""Least squares from the truth shows which worlds are solvable."""

import pytest

from tests.benchmarks.study_oracle import solvable_worlds


def test_a_world_is_solvable_with_a_long_baseline_and_not_with_noise_above_the_parallax():
    pytest.importorskip("pycolmap")
    much, little = "points:wall?noise_px=0.3&baseline=0.3&seed=1", "points:wall?noise_px=20&baseline=0.002&seed=1"
    assert solvable_worlds([much, little]) == {much}
