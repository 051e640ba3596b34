"""Laws of the table of tracks and of the choice of the views that vote."""

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from slam_init.mapping.views import further_views, table_of

POSES = make_poses(5)
MOST = 8


def test_the_table_holds_the_common_tracks_with_gaps_where_a_view_sees_none():
    seen = observe(CAMERA, POSES[:3], cloud(np.random.default_rng(5)))
    half = seen[1].at(np.arange(0, len(seen[1]), 2))
    joined = table_of(seen[0], seen[2], [half])
    assert joined.frames == (0, 2, 1)
    assert np.array_equal(joined.track_ids, seen[0].track_ids)
    assert np.array_equal(joined.pixels[0], seen[0].pixels)
    assert np.array_equal(joined.pixels[2, ::2], half.pixels)
    assert np.isnan(joined.pixels[2, 1::2]).all()
    assert np.isnan(joined.bearings[2, 1::2]).all()


def test_voting_views_are_spread_over_all_frames_up_to_the_pair_and_their_number_is_bounded():
    seen = observe(CAMERA, make_poses(20), np.array([[0.1, 0.0, 2.0]]) + cloud(np.random.default_rng(6)))
    frames = [view.frame for view in further_views(history_of(seen), seen[5], seen[19], CONFIG.map, MOST)]
    assert len(frames) == MOST
    assert frames == sorted(set(frames) - {5, 19})
    assert (frames[0], frames[-1]) == (0, 18)
    assert np.ptp(np.diff(frames)) <= 2
    # A short baseline does no harm in a vote: the frame after the reference takes part too.
    near = [view.frame for view in further_views(history_of(seen[:6]), seen[0], seen[5], CONFIG.map, MOST)]
    assert near == [1, 2, 3, 4]


def test_views_of_the_last_window_stay_and_the_new_frame_joins_them():
    seen = observe(CAMERA, make_poses(20), np.array([[0.1, 0.0, 2.0]]) + cloud(np.random.default_rng(6)))
    chosen = [0, 1]
    for current in range(2, 20):
        views = further_views(history_of(seen[: current + 1]), seen[0], seen[current], CONFIG.map, MOST, chosen)
        frames = [view.frame for view in views]
        assert frames[-1] == current - 1 or current == 1
        assert len(set(frames) - set(chosen)) <= 1
        chosen = [0, current, *frames]
    assert len(frames) == MOST
    assert np.diff(frames).max() <= 3 * np.diff(frames)[:-1].min()
