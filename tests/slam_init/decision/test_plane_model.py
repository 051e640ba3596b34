"""Laws of a plane in several views: its costs are chi-square, and its derivatives are those of finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.plane_model import (
    PlaneModel,
    PlaneViews,
    adjust_plane,
    linearize,
    normal_equations,
    plane_costs,
    stepped,
)
from slam_init.types.pose import Pose

#: A tilted plane at a distance of about 1, and four views of it in the frame of the reference view.
PLANE = np.array([0.2, -0.3, 0.8])
MOTIONS = tuple(
    Pose(rotation_from_vector(np.array([0.02, -0.05, 0.01]) * i), np.array([0.1 * i, 0.02 * i * i, -0.06 * i]))
    for i in range(1, 5)
)
TRUTH = PlaneModel(PLANE, MOTIONS)
NOISE = 1e-3


def views_of(model, count, noise, seed=0):
    """Tracks of points on the plane, with noise on all measurements."""
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.6, -0.4], [0.6, 0.4], (count, 2))
    X = np.column_stack([x, np.ones(count)])
    X /= (X @ model.k)[:, None]
    seen = [pose.apply(X) for pose in model.cam_from_reference]
    others = np.array([Y[:, :2] / Y[:, 2:] for Y in seen])
    return PlaneViews(x + rng.normal(0, noise, x.shape), others + rng.normal(0, noise, others.shape), NOISE)


def moved(model, i, amount):
    """The model after a step of one unknown."""
    step = np.zeros(3 + 6 * len(model.cam_from_reference))
    step[i] = amount
    return stepped(model, step)


# -- costs and derivatives ------------------------------------------------------------------------


def test_the_cost_of_the_truth_is_its_degrees_of_freedom():
    costs = plane_costs(views_of(TRUTH, 4000, NOISE), TRUTH)
    freedom = 2 * len(MOTIONS)
    # Four standard deviations of the mean, and of the variance about as much.
    assert costs.mean() == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom / 4000))
    assert costs.var() == pytest.approx(2 * freedom, rel=0.2)


def test_a_view_that_does_not_see_a_track_adds_no_freedom():
    views = views_of(TRUTH, 4000, NOISE)
    others = views.others.copy()
    others[1:3, ::2] = np.nan
    costs = plane_costs(replace(views, others=others), TRUTH)
    assert costs[::2].mean() == pytest.approx(4, abs=4 * np.sqrt(8 / 2000))
    assert costs[1::2].mean() == pytest.approx(8, abs=4 * np.sqrt(16 / 2000))
    others[:, 0] = np.nan
    assert plane_costs(replace(views, others=others), TRUTH)[0] == 0


def test_without_noise_the_truth_costs_nothing():
    assert plane_costs(views_of(TRUTH, 50, 0.0), TRUTH).max() < 1e-20


def test_the_derivatives_are_those_of_finite_differences():
    views, small = views_of(TRUTH, 20, 10 * NOISE), 1e-6
    _, G, J = linearize(views, TRUTH)
    for i in range(3 + 6 * len(MOTIONS)):
        ahead, behind = (linearize(views, moved(TRUTH, i, sign * small))[0] for sign in (1, -1))
        numeric = (ahead - behind) / (2 * small)
        expected = np.zeros_like(numeric)
        if i < 3:
            expected = J[..., i]
        else:
            view, column = divmod(i - 3, 6)
            expected[:, view] = J[:, view, :, 3 + column]
        np.testing.assert_allclose(numeric, expected, atol=1e-7)
    for axis in range(2):
        shift = small * np.eye(2)[axis]
        ahead, behind = (linearize(replace(views, reference=views.reference + s * shift), TRUTH)[0] for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * small), G[..., axis], atol=1e-7)


def test_the_derivatives_are_zero_where_a_view_does_not_see_a_track():
    views = views_of(TRUTH, 20, NOISE)
    views.others[2, 5] = np.nan
    for part in linearize(views, TRUTH):
        assert not part[5, 2].any()
        assert np.isfinite(part).all()


# -- adjustment -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_adjusted_model_is_as_good_as_the_truth_with_a_fifth_of_outliers(seed):
    rng = np.random.default_rng(seed)
    views = views_of(TRUTH, 300, NOISE, seed)
    views.others[:, :60] += rng.uniform(-0.1, 0.1, (len(MOTIONS), 60, 2))
    start = stepped(TRUTH, rng.normal(0, 0.01, 3 + 6 * len(MOTIONS)))
    adjusted = adjust_plane(views, start)
    costs = plane_costs(views, adjusted)[60:]
    assert costs.mean() < 1.05 * plane_costs(views, TRUTH)[60:].mean() < plane_costs(views, start)[60:].mean()
    # The scale of k is free; its direction is not.
    cosine = adjusted.k @ PLANE / np.linalg.norm(adjusted.k) / np.linalg.norm(PLANE)
    assert cosine > np.cos(np.deg2rad(1))


def test_the_normal_equations_are_the_sum_of_those_of_each_track():
    """With dense matrices, A^T W A and A^T W e of a track, where W = (1 + G G^T)^-1 times its squared weight."""
    views = views_of(TRUTH, 30, NOISE)
    views.others[1:3, ::2] = np.nan
    model = moved(TRUTH, 4, 0.003)
    e, G, J = linearize(views, model)
    freedom = 2 * np.isfinite(views.others[..., 0]).sum(axis=0)
    share = 1 / (1 + plane_costs(views, model) / (3 * freedom))
    size, K = 3 + 6 * len(MOTIONS), len(MOTIONS)
    expected_normal, expected_gradient = np.zeros((size, size)), np.zeros(size)
    for track in range(30):
        A, g = np.zeros((2 * K, size)), G[track].reshape(2 * K, 2)
        A[:, :3] = J[track, ..., :3].reshape(2 * K, 3)
        for i in range(K):
            A[2 * i : 2 * i + 2, 3 + 6 * i : 9 + 6 * i] = J[track, i, :, 3:]
        W = np.linalg.inv(np.eye(2 * K) + g @ g.T) * (share[track] / NOISE) ** 2
        expected_normal += A.T @ W @ A
        expected_gradient += A.T @ W @ e[track].reshape(-1)
    _, normal, gradient = normal_equations(views, model)
    np.testing.assert_allclose(normal, expected_normal, rtol=1e-9, atol=1e-9 * np.abs(expected_normal).max())
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-9, atol=1e-9 * np.abs(expected_gradient).max())
