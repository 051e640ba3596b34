"""The map of an adjusted bundle."""

from dataclasses import replace

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from slam_init.bundle.problem import BundleSolution
from slam_init.mapping.candidate import map_of_poses
from slam_init.mapping.map_building import initial_map, map_with_views
from slam_init.mapping.views import table_of

POSES = make_poses(4)


def adjusted():
    """An adjusted bundle, and the views of its frames."""
    rng = np.random.default_rng(1)
    seen = observe(CAMERA, POSES, cloud(rng), 0.3, rng)
    table = table_of(seen[0], seen[3], seen[1:3])
    poses = {frame: pose.inverse() for frame, pose in enumerate(POSES)}
    bundle = map_of_poses(CAMERA, CONFIG, table, poses, CONFIG.two_view.threshold_px / CAMERA.focal_px)
    assert isinstance(bundle, BundleSolution)
    return bundle, seen


def test_the_map_holds_the_adjusted_bundle_and_the_observations_of_its_keyframes():
    bundle, seen = adjusted()
    built = map_with_views(history_of(seen), bundle, "general")
    assert tuple(view.frame for view in built.views) == bundle.problem.frames
    assert tuple(keyframe.frame for keyframe in built.map.keyframes) == bundle.problem.frames
    assert [keyframe.name for keyframe in built.map.keyframes] == [view.name for view in built.views]
    assert built.map.points is bundle.problem.points
    assert built.map.scene == "general"
    assert built.map.reprojection_rmse_px == bundle.rmse_px


def test_landmarks_take_the_color_of_their_track_and_are_grey_without_one():
    bundle, seen = adjusted()
    views = [seen[frame] for frame in bundle.problem.frames]
    assert (initial_map(bundle, views, "general").colors == 128).all()
    red = np.tile(np.array([200, 10, 10], np.uint8), (len(views[0]), 1))
    coloured = [replace(view, colors=red) for view in views]
    assert (initial_map(bundle, coloured, "general").colors == (200, 10, 10)).all()
