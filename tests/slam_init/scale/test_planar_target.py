"""Laws of the size of a planar target: it is that of the scene, as uncertain as stated, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from make_metric import TARGET, adjusted_map, sightings, true_scale
from make_scene import cloud

from slam_init.bundle.graph import joint_pose_covariance
from slam_init.scale.planar_target import fit_target
from slam_init.types.pose import Pose

MAP = adjusted_map(cloud(np.random.default_rng(1)), noise_px=0.01)


def test_the_size_of_a_target_is_that_of_the_scene():
    size = fit_target(MAP, sightings(MAP))
    assert np.exp(-size.log_units) == pytest.approx(true_scale(MAP), rel=2e-3)
    assert size.frames == tuple(keyframe.frame for keyframe in MAP.keyframes)


def test_the_stated_deviation_is_that_of_the_errors():
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        map_ = adjusted_map(cloud(rng), 0.3, seed)
        size = fit_target(map_, sightings(map_, noise_px=0.3, rng=rng))
        covariance = joint_pose_covariance(map_.graph, map_.values, tuple(k.frame for k in map_.keyframes))
        sigma = np.sqrt(size.variance + size.by_poses @ covariance @ size.by_poses)
        errors.append((-size.log_units - np.log(true_scale(map_))) / sigma)
    # Ten draws: the root mean square exceeds the bound with a probability below 1 %. The graph also knows errors that
    # tracks share, of which these have none.
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_half_a_turn_of_a_board_changes_nothing():
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    corners = np.stack([x.ravel() - 2, y.ravel() - 1.5, np.zeros(x.size)], axis=1)
    seen = sightings(MAP, 0.03, points=corners)
    turned = [replace(one, pixels=one.pixels[::-1]) if k % 2 else one for k, one in enumerate(seen)]
    assert fit_target(MAP, turned).log_units == pytest.approx(fit_target(MAP, seen).log_units, abs=1e-9)


def test_a_view_that_shows_another_place_is_left_out():
    seen = sightings(MAP)
    wrong = replace(seen[2], pixels=seen[2].pixels + np.array([40.0, 0.0]))
    size = fit_target(MAP, [*seen[:2], wrong, *seen[3:]])
    assert wrong.frame not in size.frames
    assert np.exp(-size.log_units) == pytest.approx(true_scale(MAP), rel=2e-3)


def test_a_target_that_moves_determines_nothing():
    places = [sightings(MAP, target=Pose(TARGET.R, TARGET.t + np.array([0.0, 0.1 * k * k, 0.0]))) for k in range(5)]
    assert fit_target(MAP, [places[k][k] for k in range(5)]) is None


def test_a_single_view_or_no_keyframe_determines_nothing():
    assert fit_target(MAP, sightings(MAP)[:1]) is None
    assert fit_target(MAP, [replace(one, frame=one.frame + 1) for one in sightings(MAP)]) is None
