"""The map of an adjusted bundle."""

from dataclasses import replace

import numpy as np
from make_candidates import general_candidate, general_views
from make_scene import history_of

from slam_init.mapping.map_building import initial_map, map_with_views


def test_the_map_holds_the_adjusted_bundle_and_the_observations_of_its_keyframes():
    bundle, seen = general_candidate().bundle, general_views()
    built = map_with_views(history_of(seen), bundle, "general")
    assert tuple(view.frame for view in built.views) == bundle.problem.frames
    assert tuple(keyframe.frame for keyframe in built.map.keyframes) == bundle.problem.frames
    assert [keyframe.name for keyframe in built.map.keyframes] == [view.name for view in built.views]
    assert built.map.points is bundle.problem.points
    assert built.map.scene == "general"
    assert built.map.reprojection_rmse_px == bundle.rmse_px


def test_landmarks_take_the_color_of_their_track_and_are_grey_without_one():
    bundle, seen = general_candidate().bundle, general_views()
    views = [seen[frame] for frame in bundle.problem.frames]
    assert (initial_map(bundle, views, "general").colors == 128).all()
    red = np.tile(np.array([200, 10, 10], np.uint8), (len(views[0]), 1))
    coloured = [replace(view, colors=red) for view in views]
    assert (initial_map(bundle, coloured, "general").colors == (200, 10, 10)).all()
