"""The RANSAC loop on a line-fitting problem: the loop contains no geometry."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_ransac import ransac

from quest.robust.samples import draw_samples, samples_needed

SEEDS = st.integers(0, 2**32 - 1)
SLOPE, OFFSET = 0.7, -0.2


class Lines:
    """Lines y = a x + b through points (N, 2); a point farther than 0.05 from the line is an outlier."""

    sample_size = 2
    limit = 0.05

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self.batches: list[int] = []

    def __len__(self) -> int:
        return len(self.points)

    def solve(self, samples: np.ndarray) -> np.ndarray:
        self.batches.append(len(samples))
        (x1, y1), (x2, y2) = np.moveaxis(self.points[samples], 0, -1)
        apart = np.abs(x2 - x1) > 1e-9
        a = (y2 - y1)[apart] / (x2 - x1)[apart]
        return np.column_stack([a, y1[apart] - a * x1[apart]])

    def costs(self, models: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.points.T
        r2 = (models[:, :1] * x + models[:, 1:] - y) ** 2
        return np.minimum(r2, self.limit**2).sum(axis=1), (r2 < self.limit**2).sum(axis=1)

    def polish(self, model: np.ndarray) -> np.ndarray:
        x, y = self.points.T
        near = np.abs(model[0] * x + model[1] - y) < self.limit
        return np.polyfit(x[near], y[near], 1) if near.sum() > 2 else model


def noisy_line(seed: int, count: int = 200, outliers: float = 0.5, noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, count)
    y = SLOPE * x + OFFSET + noise * rng.normal(size=count)
    wrong = int(outliers * count)
    y[:wrong] = rng.uniform(-1, 1, wrong)
    return np.column_stack([x, y])


# --- samples_needed ---


def test_the_number_of_samples_is_that_of_the_textbook():
    # Hartley and Zisserman, table 4.3, p = 0.99: samples of 7, 50 % outliers -> 588; samples of 2, 20 % -> 5.
    assert math.ceil(samples_needed(0.5, 7, 0.99, 1.0)) == 588
    assert math.ceil(samples_needed(0.8, 2, 0.99, 1.0)) == 5


@given(
    share=st.floats(0.05, 0.999),
    size=st.integers(1, 8),
    confidence=st.floats(0.5, 0.99999),
    chance=st.floats(0.1, 1),
)
def test_all_needed_samples_fail_with_the_remaining_probability(share, size, confidence, chance):
    needed = samples_needed(share, size, confidence, chance)
    all_fail = math.exp(needed * math.log1p(-chance * share**size))
    assert all_fail == pytest.approx(1 - confidence)


def test_one_sample_is_enough_without_outliers_and_no_number_is_enough_without_inliers():
    assert samples_needed(1.0, 6, 0.99, 1.0) == 1
    assert samples_needed(0.0, 6, 0.99, 0.5) == math.inf


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


# --- the loop ---


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_the_line_is_found_among_50_percent_of_outliers(seed):
    problem = Lines(noisy_line(seed))
    report = ransac(problem, np.random.default_rng(seed))
    assert report is not None
    assert report.models[0] == pytest.approx([SLOPE, OFFSET], abs=0.03)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, pool=st.integers(1, 10))
def test_the_report_holds_models_ordered_by_cost(seed, pool):
    problem = Lines(noisy_line(seed, outliers=0.3))
    report = ransac(problem, np.random.default_rng(seed), pool=pool)
    assert report is not None
    assert len(report.models) == pool
    assert report.costs == pytest.approx(problem.costs(report.models)[0])
    assert (np.diff(report.costs[1:]) >= 0).all()
    assert report.samples == sum(problem.batches)


def test_the_refined_model_has_the_lowest_cost():
    # A line through two noisy points has a higher cost than the fit to all of its inliers.
    problem = Lines(noisy_line(4, outliers=0.2, noise=0.02))
    report = ransac(problem, np.random.default_rng(0))
    assert report is not None
    assert report.costs[0] < report.costs[1]


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not():
    first, second, other = (ransac(Lines(noisy_line(1)), np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first is not None
    assert second is not None
    assert other is not None
    assert first.models.tobytes() == second.models.tobytes()
    assert first.samples == second.samples
    assert first.models.tobytes() != other.models.tobytes()


def test_easy_data_stop_early_and_hopeless_data_stop_at_the_bound():
    easy, hopeless = Lines(noisy_line(2, outliers=0.0)), Lines(noisy_line(2, outliers=1.0))
    easy.limit, hopeless.limit = 0.05, 0.001
    few = ransac(easy, np.random.default_rng(0), min_samples=20, max_samples=500)
    many = ransac(hopeless, np.random.default_rng(0), max_samples=500)
    assert few is not None
    assert many is not None
    assert 20 <= few.samples < 100
    assert many.samples == 500


def test_the_report_is_none_where_no_sample_proposes_a_model():
    upright = np.column_stack([np.zeros(50), np.linspace(-1, 1, 50)])
    problem = Lines(upright)
    assert ransac(problem, np.random.default_rng(0), max_samples=100) is None
    assert sum(problem.batches) == 100


def test_the_report_is_none_for_fewer_data_than_a_sample_takes():
    problem = Lines(np.zeros((1, 2)))
    assert ransac(problem, np.random.default_rng(0)) is None
    assert problem.batches == []
