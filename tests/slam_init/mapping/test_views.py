"""Laws of the table of tracks and of the choice of the views that vote."""

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from slam_init.mapping.views import further_views

MOST = 8


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
