"""Laws of the map of known poses: the views that vote, and failures with their cause."""

import re

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.problem import BundleFailure
from slam_init.mapping.map_building import map_of_poses
from slam_init.mapping.views import further_views, table_of
from slam_init.types.pose import Pose

POSES = make_poses(5)


def test_wrong_poses_and_too_few_points_are_failures_with_their_cause():
    rng = np.random.default_rng(1)
    seen = observe(CAMERA, POSES, cloud(rng), 0.3, rng)
    turned = [*POSES[:4], Pose(rotation_from_vector(np.array([0.5, 0.0, 0.0])) @ POSES[4].R, POSES[4].t)]
    for views, poses, cause in (
        (seen, turned, r"points can be triangulated"),
        ([view.at(np.arange(4)) for view in seen], POSES, r"^only 4 points can be triangulated$"),
    ):
        table = table_of(views[0], views[4], views[1:4])
        cam_from_world = {frame: pose.inverse() for frame, pose in enumerate(poses)}
        failed = map_of_poses(CAMERA, CONFIG, table, cam_from_world, CONFIG.two_view.threshold_px / CAMERA.focal_px)
        assert isinstance(failed, BundleFailure) and re.search(cause, failed.cause)


# -- law of the choice of the views that vote ------------------------------------------------------


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
