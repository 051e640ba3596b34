"""Planes and lines among the inliers of a motion, and whether the translation of an estimate is observable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_two_views import NOISE_RAD, R_TRUE, T_TRUE, box, views
from make_views import unit

from quest import estimate_relative_pose
from quest.covariance import pose_covariance
from quest.geometry.quaternion import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_angle,
    rotation_from_vector,
)
from quest.relative_pose import Hypothesis
from quest.robust import kernels
from quest.robust.plane import fit_plane
from tests.benchmarks.quest.reference import sampson_jacobian

SEEDS = st.integers(0, 2**32 - 1)
MODEL = np.concatenate([quaternion_from_matrix(R_TRUE), T_TRUE / np.linalg.norm(T_TRUE)])
laws = settings(max_examples=25)


def points(seed: int, count: int = 200, *, on_plane: float) -> np.ndarray:
    """Points of a box of depths 3 to 6; the first of them are moved along their rays to a tilted plane."""
    X = box(seed, count)
    X[: int(on_plane * count)] *= (4.5 / (X @ [-0.3, 0.6, 1]))[: int(on_plane * count), None]
    return X


# --- fit_plane ---


@laws
@given(seed=SEEDS)
def test_all_points_of_a_plane_lie_on_it_and_its_poses_are_the_motion_and_the_second_motion(seed):
    m, n = views(points(seed, on_plane=1.0), noise_rad=NOISE_RAD, seed=seed)
    plane = fit_plane(MODEL, m, n, NOISE_RAD)
    assert plane.on + plane.off == 200
    assert plane.off <= 8  # three deviations of each component are exceeded once in a hundred or less
    assert 120 < plane.depth_variation < 290  # chi-square of 200 degrees of freedom: four deviations
    motion, second = plane.poses
    for pose in plane.poses:
        assert np.linalg.norm(pose[:4]) == pytest.approx(1)
        assert np.linalg.norm(pose[4:]) == pytest.approx(1)
    assert rotation_angle(matrix_from_quaternion(motion[:4]) @ R_TRUE.T) < np.radians(0.5)
    assert motion[4:] @ MODEL[4:] > np.cos(np.radians(4))
    assert second[4:] @ MODEL[4:] < np.cos(np.radians(4))


def test_an_exact_plane_gives_the_exact_motion():
    plane = fit_plane(MODEL, *views(points(0, on_plane=1.0)), NOISE_RAD)
    assert (plane.on, plane.off) == (200, 0)
    assert plane.depth_variation < 1e-9
    assert abs(plane.poses[0][:4] @ MODEL[:4]) == pytest.approx(1, abs=1e-12)
    assert plane.poses[0][4:] == pytest.approx(MODEL[4:], abs=1e-6)


@laws
@given(seed=SEEDS)
def test_points_off_a_plane_are_counted(seed):
    m, n = views(points(seed, on_plane=0.7), noise_rad=NOISE_RAD, seed=seed)
    plane = fit_plane(MODEL, m, n, NOISE_RAD)
    # A few points of the box lie within three deviations of the plane.
    assert 130 <= plane.on <= 155
    assert plane.on + plane.off == 200
    assert len(plane.poses) == 2


@laws
@given(seed=SEEDS, on_plane=st.floats(0, 0.3))
def test_a_minority_of_points_on_a_plane_gives_no_plane(seed, on_plane):
    plane = fit_plane(MODEL, *views(points(seed, on_plane=on_plane), noise_rad=NOISE_RAD, seed=seed), NOISE_RAD)
    assert plane.poses == []
    assert plane.on < plane.off


def test_seven_points_and_equal_points_give_no_plane():
    m, n = views(points(0, 7, on_plane=1.0), noise_rad=NOISE_RAD)
    plane = fit_plane(MODEL, m, n, NOISE_RAD)
    assert (plane.on, plane.off, plane.poses) == (0, 7, [])
    assert fit_plane(MODEL, *(np.repeat(rays[:1], 20, axis=0) for rays in (m, n)), NOISE_RAD).poses == []


# --- off_line ---


def strip(seed: int, half_width_rad: float, count: int = 300) -> np.ndarray:
    """Rays that scatter about a great circle of any direction."""
    rng = np.random.default_rng(seed)
    along, across = rng.uniform(-0.7, 0.7, count), half_width_rad * rng.normal(size=count)
    rays = unit(np.column_stack([np.sin(along), across, np.cos(along)]))
    return rays @ rotation_from_vector(rng.uniform(-2, 2, 3)).T


@laws
@given(seed=SEEDS, half_width_rad=st.floats(1e-5, 0.05))
def test_the_width_of_a_strip_is_measured(seed, half_width_rad):
    # A median of 300 values has a deviation of 7 %; the bound is five deviations.
    assert kernels.off_line(strip(seed, half_width_rad), 3.0) == pytest.approx(half_width_rad, rel=0.35)


# --- whether the translation of an estimate is observable ---


def test_the_same_translation_is_observable_with_less_noise_only():
    X = points(0, on_plane=0.0)
    tiny = 0.002 * T_TRUE  # baseline 0.0005 of the depth
    noisy, sharp = (estimate_relative_pose(*views(X, noise_rad=s, t=tiny)) for s in (NOISE_RAD, 5e-6))
    assert noisy.kind == "rotation"
    assert sharp.kind == "general"
    assert sharp.parallax.observable(1e-9)
    assert sharp.parallax.p_value < noisy.parallax.p_value


# --- covariance ---


@laws
@given(seed=SEEDS)
def test_where_the_parallax_is_large_the_covariance_is_that_of_least_squares(seed):
    m, n = views(points(seed, on_plane=0.0), noise_rad=NOISE_RAD, seed=seed)
    every = Hypothesis(MODEL[:4], R_TRUE, MODEL[4:], np.ones(len(m), bool))
    _, J = sampson_jacobian(R_TRUE, MODEL[4:], m, n)
    plain = NOISE_RAD * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    found = np.sqrt(np.diag(pose_covariance(every, m, n, NOISE_RAD)))
    assert ((found > 0.8 * plain) & (found < 1.4 * plain)).all()
