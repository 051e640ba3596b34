"""The vote of all views with the plane as a constraint: its costs are chi-square, and it decides where it can."""

from dataclasses import replace

import numpy as np
import pytest
from make_scene import CAMERA, observe, plane, table

from quest import estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.decision.plane_vote import (
    PlaneModel,
    PlaneViews,
    _linearize,
    _moved,
    _normal_equations,
    adjust_plane,
    plane_costs,
    plane_margin,
    plane_of_motion,
)
from slam_init.mapping.views import table_of
from slam_init.types.pose import Pose

#: A tilted plane at a distance of about 1, and four views of it in the reference's frame.
PLANE = np.array([0.2, -0.3, 0.8])
MOTIONS = tuple(
    Pose(rotation_from_vector(np.array([0.02, -0.05, 0.01]) * i), np.array([0.1 * i, 0.02 * i * i, -0.06 * i]))
    for i in range(1, 5)
)
TRUTH = PlaneModel(PLANE, MOTIONS)
NOISE = 1e-3
#: Towards a plane in a curve, so that all points lie before the twin's cameras too.
CURVE = [
    Pose(
        rotation_from_vector(np.array([0.01, -0.02, 0.01]) * k),
        np.array([0.03 * k + 0.012 * k * k, 0.01 * k, 0.09 * k]),
    )
    for k in range(5)
]


def views_of(model, count, noise, seed=0):
    """Tracks of points on the plane, all measurements with noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.6, -0.4], [0.6, 0.4], (count, 2))
    X = np.column_stack([x, np.ones(count)])
    X /= (X @ model.k)[:, None]
    seen = [pose.apply(X) for pose in model.cam_from_reference]
    others = np.array([Y[:, :2] / Y[:, 2:] for Y in seen])
    return PlaneViews(x + rng.normal(0, noise, x.shape), others + rng.normal(0, noise, others.shape), NOISE)


def stepped(model, i, amount):
    step = np.zeros(3 + 6 * len(model.cam_from_reference))
    step[i] = amount
    return _moved(model, step)


# -- costs and derivatives ------------------------------------------------------------------------


def test_the_cost_of_the_truth_is_its_degrees_of_freedom():
    costs = plane_costs(views_of(TRUTH, 4000, NOISE), TRUTH)
    freedom = 2 * len(MOTIONS)
    # Four standard deviations of the mean, and of the variance about as much.
    assert costs.mean() == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom / 4000))
    assert costs.var() == pytest.approx(2 * freedom, rel=0.2)


def test_a_view_that_does_not_see_a_track_gives_it_no_freedom():
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
    _, G, J = _linearize(views, TRUTH)
    for i in range(3 + 6 * len(MOTIONS)):
        ahead, behind = (_linearize(views, stepped(TRUTH, i, sign * small))[0] for sign in (1, -1))
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
        ahead, behind = (_linearize(replace(views, reference=views.reference + s * shift), TRUTH)[0] for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * small), G[..., axis], atol=1e-7)


def test_the_derivatives_of_what_is_not_seen_are_zero():
    views = views_of(TRUTH, 20, NOISE)
    views.others[2, 5] = np.nan
    for part in _linearize(views, TRUTH):
        assert not part[5, 2].any()
        assert np.isfinite(part).all()


# -- adjustment -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_adjusted_model_is_as_good_as_the_truth_whatever_moves_by_itself(seed):
    rng = np.random.default_rng(seed)
    views = views_of(TRUTH, 300, NOISE, seed)
    views.others[:, :60] += rng.uniform(-0.1, 0.1, (len(MOTIONS), 60, 2))
    start = _moved(TRUTH, rng.normal(0, 0.01, 3 + 6 * len(MOTIONS)))
    adjusted = adjust_plane(views, start)
    costs = plane_costs(views, adjusted)[60:]
    assert costs.mean() < 1.05 * plane_costs(views, TRUTH)[60:].mean() < plane_costs(views, start)[60:].mean()
    # The scale is free: the plane's direction is not.
    cosine = adjusted.k @ PLANE / np.linalg.norm(adjusted.k) / np.linalg.norm(PLANE)
    assert cosine > np.cos(np.deg2rad(1))


def test_the_plane_of_a_motion_is_the_one_that_most_points_are_on():
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform([-0.6, -0.4], [0.6, 0.4], (200, 2)), np.ones(200)])
    X /= (X @ PLANE)[:, None]
    X[:40] *= rng.uniform(1.2, 2.0, (40, 1))
    Y = MOTIONS[3].apply(X)
    m, n = (P / np.linalg.norm(P, axis=1, keepdims=True) for P in (X, Y))
    np.testing.assert_allclose(plane_of_motion(MOTIONS[3].R, MOTIONS[3].t, m, n), PLANE, rtol=1e-3)


# -- the vote -------------------------------------------------------------------------------------


def true_and_twin(seen, poses):
    """The two explanations of the pair of first and last view, and the noise of a bearing."""
    pose = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px, seed=0)
    assert pose.kind == "planar"
    both = [pose, *pose.alternatives]
    assert len(both) == 2
    truth = poses[-1].inverse() @ poses[0]
    return *sorted(both, key=lambda each: rotation_angle(each.R.T @ truth.R)), pose.noise_rad


@pytest.mark.parametrize("seed", range(3))
def test_views_in_a_curve_decide_for_the_truth(seed):
    rng = np.random.default_rng(seed)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    there = plane_margin(table(seen), true, twin, noise_rad)
    back = plane_margin(table(seen), twin, true, noise_rad)
    assert there.decides()
    assert replace(there, z=3.5, log_likelihood=25.0).decides()  # maps of free points need four
    assert (back.log_likelihood, back.z) == pytest.approx((-there.log_likelihood, -there.z))


@pytest.mark.parametrize("seed", range(3))
def test_views_that_repeat_the_pair_decide_nothing(seed):
    """However many there are: two views have two explanations, and the same two views have the same ones."""
    rng = np.random.default_rng(seed)
    poses = [CURVE[0], *[CURVE[4]] * 5]
    seen = observe(CAMERA, poses, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, poses)
    vote = plane_margin(table(seen), true, twin, noise_rad)
    assert not vote.decides()
    assert not vote.reversed().decides()


def test_there_is_no_vote_without_a_third_view_of_the_plane():
    rng = np.random.default_rng(0)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    assert plane_margin(table_of(seen[0], seen[-1], []), true, twin, noise_rad) is None
    few = 8
    blind = replace(
        seen[2], track_ids=seen[2].track_ids[:few], pixels=seen[2].pixels[:few], bearings=seen[2].bearings[:few]
    )
    assert plane_margin(table_of(seen[0], seen[-1], [blind]), true, twin, noise_rad) is None


def test_rays_beside_the_camera_have_no_vote():
    rng = np.random.default_rng(0)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    beside = table(seen)
    beside.bearings[2, 7] = [1.0, 0.0, 0.05]
    assert plane_margin(beside, true, twin, noise_rad) is None


def test_the_equations_of_a_step_are_those_of_all_tracks_written_out():
    """Track by track with dense matrices: A^T W A and A^T W e, W = (1 + G G^T)^-1 times the squared share."""
    views = views_of(TRUTH, 30, NOISE)
    views.others[1:3, ::2] = np.nan
    model = stepped(TRUTH, 4, 0.003)
    e, G, J = _linearize(views, model)
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
    _, normal, gradient = _normal_equations(views, model)
    np.testing.assert_allclose(normal, expected_normal, rtol=1e-9, atol=1e-9 * np.abs(expected_normal).max())
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-9, atol=1e-9 * np.abs(expected_gradient).max())
