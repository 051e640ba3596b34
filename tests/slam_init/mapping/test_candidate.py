"""Laws of the map of known poses: what allows no map is a failure with its cause."""

import re

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.problem import BundleFailure
from slam_init.mapping.candidate import map_of_poses
from slam_init.mapping.views import table_of
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
