"""Laws of a map in metres: the same map in another unit, whose graph keeps the scale and its deviation."""

import gtsam
import numpy as np
import pytest
from make_metric import adjusted_map
from make_scene import cloud

from slam_init.bundle.graph import landmark_key, pose_key
from slam_init.bundle.problem import PosePrior
from slam_init.errors import SlamInitError
from slam_init.scale.metric_map import in_metres
from slam_init.types.scale import Scale, ScaleOrigin

SCALE = Scale(ScaleOrigin.DISTANCE, 4.0, 0.03)
MAP = adjusted_map(cloud(np.random.default_rng(2)))


def ranges(map_):
    factors = [map_.graph.at(i) for i in range(map_.graph.size())]
    return [factor for factor in factors if isinstance(factor, gtsam.RangeFactorPose3)]


def marginals(map_):
    found = gtsam.Marginals(map_.graph, map_.values)
    return np.array([found.marginalCovariance(pose_key(k.frame)) for k in map_.keyframes])


def test_all_lengths_have_the_factor_and_no_residual_changes():
    metric = in_metres(MAP, SCALE)
    np.testing.assert_allclose(metric.points, 4 * MAP.points)
    np.testing.assert_allclose(metric.points_before, 4 * MAP.points_before)
    for before, after in zip(MAP.keyframes, metric.keyframes, strict=True):
        np.testing.assert_allclose(after.world_from_cam.t, 4 * before.world_from_cam.t)
        value = metric.values.atPose3(pose_key(after.frame))
        np.testing.assert_allclose(value.translation(), after.world_from_cam.t, atol=1e-9)
    assert metric.graph.error(metric.values) == pytest.approx(MAP.graph.error(MAP.values), rel=1e-9)
    np.testing.assert_allclose(gtsam.utilities.extractPoint3(metric.values), metric.points)
    assert metric.scale == SCALE


def test_the_range_of_the_graph_is_the_prior_of_the_scale():
    (before,), (after,) = ranges(MAP), ranges(in_metres(MAP, SCALE))
    assert after.measured() == pytest.approx(4 * before.measured())
    assert after.noiseModel().sigmas()[0] == pytest.approx(0.03 * after.measured())
    assert list(after.keys()) == list(before.keys())


def of_points(map_):
    found = gtsam.Marginals(map_.graph, map_.values)
    return np.array([found.marginalCovariance(landmark_key(track)) for track in map_.track_ids.tolist()])


def test_the_scale_adds_the_same_to_the_covariances_of_the_map_and_of_the_graph():
    metric, unit = in_metres(MAP, SCALE), np.outer(np.repeat([1.0, 4.0], 3), np.repeat([1.0, 4.0], 3))
    added = metric.pose_covariances - unit * MAP.pose_covariances
    np.testing.assert_allclose(added, marginals(metric) - unit * marginals(MAP), rtol=1e-3, atol=1e-7)
    assert added[-1].max() > 1e-4
    added = metric.point_covariances - 16 * MAP.point_covariances
    expected = of_points(metric) - 16 * of_points(MAP)
    np.testing.assert_allclose(added, expected, rtol=0.01, atol=0.01 * expected.max())


def test_a_depth_in_metres_is_as_uncertain_as_the_scale_at_least():
    metric = in_metres(MAP, SCALE)
    np.testing.assert_allclose(metric.depth_sigmas**2, MAP.depth_sigmas**2 + 0.03**2, atol=2e-6)
    assert np.isfinite(in_metres(MAP, Scale(ScaleOrigin.GROUNDTRUTH, 4.0, 0.0)).depth_sigmas).all()


def test_priors_of_poses_do_not_determine_the_scale():
    map_ = in_metres(adjusted_map(cloud(np.random.default_rng(2)), prior=PosePrior(0.002, 0.01)), SCALE)
    assert any(isinstance(map_.graph.at(i), gtsam.PriorFactorPose3) for i in range(map_.graph.size()))
    last = map_.keyframes[-1].world_from_cam
    along = last.R.T @ last.t / (last.t @ last.t)
    assert np.sqrt(along @ marginals(map_)[-1, 3:, 3:] @ along) == pytest.approx(0.03, rel=0.05)


def test_a_map_is_not_scaled_twice_or_without_a_scale():
    with pytest.raises(SlamInitError, match="already"):
        in_metres(in_metres(MAP, SCALE), SCALE)
    with pytest.raises(SlamInitError, match="no marker"):
        in_metres(MAP, Scale(ScaleOrigin.MARKER, reason="no marker is in the keyframes"))
