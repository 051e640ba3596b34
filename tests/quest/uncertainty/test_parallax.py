"""The statement on parallax: its error rate, its power, and degenerate scenes."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_two_views import box, plane, wall
from make_two_views import views as views_of
from make_views import unit

from quest import InputError, parallax_statement
from quest.geometry.epipolar import sampson_error
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector
from quest.robust import kernels
from quest.tails import gaussian_tail, poisson_tail
from tests.benchmarks.quest.reference import refine_pose

NOISE_RAD = 1.5e-3


SHAPES = pytest.mark.parametrize("shape", ["box", "plane", "wall"])


@dataclass(frozen=True, eq=False)
class Views:
    """Matches of two views and their true motion; |t| = 1, and ``ratios`` are the true |t|/depth in camera 1."""

    m: np.ndarray
    n: np.ndarray
    R: np.ndarray
    t: np.ndarray
    ratios: np.ndarray


def views(seed, *, ratio=0.1, count=200, noise_rad=NOISE_RAD, shape="box"):
    """A box, a tilted plane or a wall; 4 degrees about a random axis, and any direction of the translation.

    ``ratio`` is |t| divided by the median depth.
    """
    X = {"box": box, "plane": plane, "wall": wall}[shape](seed, count)
    rng = np.random.default_rng(seed)
    R, t = rotation_from_vector(np.deg2rad(4) * unit(rng.normal(size=3))), unit(rng.normal(size=3))
    depths = np.linalg.norm(X, axis=1)
    length = ratio * float(np.median(depths))
    return Views(*views_of(X, R, length * t, noise_rad=noise_rad, seed=seed), R, t, length / depths)


def refined_motion(two):
    """R, t and the inliers of the motion that is refined from the true one, and the statement about its parallax."""
    R, t, gate = two.R, two.t, 3 * NOISE_RAD
    for _ in range(3):
        residuals = sampson_error(R, t, two.m, two.n)
        kept = np.abs(residuals) < gate
        gate = min(3 * NOISE_RAD, 3 * float(np.sqrt(np.sum(residuals[kept] ** 2) / (kept.sum() - 5))))
        R, t = refine_pose(R, t, two.m[kept], two.n[kept], gate)
    kept = np.abs(sampson_error(R, t, two.m, two.n)) < gate
    wrong = int((~kept).sum())
    return R, t, kept, parallax_statement(R, t, two.m[kept], two.n[kept], wrong_matches=wrong)


def true_ratio(two, R, t, kept=None):
    """The true weighted mean of |t|/depth over the matches in the mean of the statement."""
    typical = np.ones(len(two.m), bool) if kept is None else kept.copy()
    kernels.mark_typical(two.m, two.n, R, t, typical)
    sine2 = 1 - (two.n[typical] @ t) ** 2
    return float(sine2 @ two.ratios[typical] / sine2.sum())


@given(st.floats(-6, 30))
def test_the_gaussian_tail_is_half_of_the_complementary_error_function(z):
    assert gaussian_tail(z) == pytest.approx(0.5 * math.erfc(z / math.sqrt(2)), rel=1e-11, abs=1e-300)


@given(st.integers(-3, 400), st.floats(0.01, 300))
def test_the_poisson_tail_is_one_less_the_sum_of_the_terms_below(count, mean):
    below = sum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1)) for k in range(count))
    assert poisson_tail(count, mean) == pytest.approx(1 - below, rel=1e-9, abs=1e-12)


def test_an_exact_translation_is_observed_with_certainty():
    two = views(1, noise_rad=0.0)
    statement = parallax_statement(two.R, two.t, two.m, two.n)
    assert statement.p_value < 1e-12
    assert statement.ratio == pytest.approx(true_ratio(two, two.R, two.t), rel=1e-9)
    assert statement.ratio_sigma < 1e-9


def test_expected_chance_matches_raise_the_p_value_of_far_matches():
    two = views(2, ratio=0.0, count=300)
    n = two.n.copy()
    # Eight outliers on their epipolar lines, far from their true places, as after the choice of the best motion.
    n[:8] += 0.2 * (two.t - (n[:8] @ two.t)[:, None] * n[:8])
    naive = parallax_statement(two.R, two.t, two.m, n)
    aware = parallax_statement(two.R, two.t, two.m, n, chance_matches=5.0)
    assert naive.far == aware.far == 8
    assert naive.p_value < 1e-3 < 0.05 < aware.p_value


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.0, 0.1))
def test_frame_of_camera_2_lengths_and_order_do_not_change_the_statement(seed, ratio):
    two = views(seed, ratio=ratio, count=60)
    rng = np.random.default_rng(seed)
    turn = rotation_from_vector(rng.normal(size=3))
    order = rng.permutation(60)
    reference = parallax_statement(two.R, two.t, two.m, two.n)
    q = quaternion_from_matrix(turn @ two.R)
    other = parallax_statement(q, 7 * (turn @ two.t), 3 * two.m[order], (two.n @ turn.T)[order])
    assert other.p_value == pytest.approx(reference.p_value, rel=1e-5, abs=1e-300)
    assert other.ratio == pytest.approx(reference.ratio, rel=1e-6, abs=1e-9)
    assert (other.near, other.far) == (reference.near, reference.far)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q_or_R": np.zeros(4)}, "zero"),
        ({"q_or_R": 2 * np.eye(3)}, "no rotation"),
        ({"q_or_R": np.eye(2)}, r"\(2, 2\)"),
        ({"t": np.zeros(3)}, "not all zero"),
        ({"m": np.ones((5, 3)), "n": np.ones((5, 3))}, "at least 6"),
        ({"noise_rad": 0.0}, "noise_rad"),
        ({"chance_matches": -1.0}, "chance_matches"),
        ({"wrong_matches": 1.5}, "wrong_matches"),
    ],
)
def test_wrong_arguments_are_named(change, message):
    two = views(0, count=20)
    good = {"q_or_R": two.R, "t": two.t, "m": two.m, "n": two.n}
    with pytest.raises(InputError, match=message):
        parallax_statement(**{**good, **change})


# --- the test value and the deviation of the ratio ---


@SHAPES
def test_without_translation_the_test_value_is_that_of_a_normal_deviate_or_smaller(shape):
    values = []
    for seed in range(200):
        two = views(seed, shape=shape, ratio=0.0, count=60)
        t = np.random.default_rng([seed, 1]).normal(size=3)
        values.append(parallax_statement(two.R, t, two.m, two.n, NOISE_RAD).test_value)
    assert -0.5 < np.mean(values) < 0.21  # three deviations of the mean of 200 values
    assert 0.85 < np.std(values) < 1.15
    assert np.mean(np.array(values) > 1.645) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 200)


@SHAPES
def test_the_stated_deviation_of_the_ratio_covers_the_noise_of_points_and_motion(shape):
    """The motion is refined from the true one, so that its error is in that of the ratio."""
    errors = []
    for seed in range(40):
        two = views(seed, ratio=0.05, shape=shape)
        R, t, kept, statement = refined_motion(two)
        errors.append((statement.ratio - true_ratio(two, R, t, kept)) / statement.ratio_sigma)
    assert np.mean(np.abs(errors) < 2) > 0.85
    assert 0.7 < np.std(errors) < 1.3
