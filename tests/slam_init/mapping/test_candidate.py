"""Laws of the map of known poses: the true poses give the scene, and no point of a wrong pose becomes a landmark."""

from dataclasses import replace

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, observe

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle.problem import BundleFailure, BundleSolution
from slam_init.mapping.map_building import map_of_poses
from slam_init.mapping.views import table_of
from slam_init.types.pose import Pose

POSES = make_poses(5)
THRESHOLD_RAD = CONFIG.two_view.threshold_px / CAMERA.focal_px


def seen_by_all(noise_px=0.3):
    rng = np.random.default_rng(1)
    return observe(CAMERA, POSES, cloud(rng), noise_px, rng)


def cam_from_world(frames, poses=POSES):
    return {frame: poses[frame].inverse() for frame in frames}


def built(seen, pair, frames, poses=POSES):
    """The map of the views of some frames, whose first two are the pair."""
    first, second = pair
    further = [view for view in seen if view.frame not in pair]
    table = table_of(seen[first], seen[second], further)
    return map_of_poses(CAMERA, CONFIG, table, cam_from_world(frames, poses), THRESHOLD_RAD)


def test_the_map_of_the_true_poses_is_the_scene():
    bundle = built(seen_by_all(), (0, 4), range(5))
    assert isinstance(bundle, BundleSolution)
    assert len(bundle.problem.points) > 100
    assert bundle.problem.frames == (0, 1, 2, 3, 4)
    for frame, pose in zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True):
        assert rotation_angle(pose.R.T @ POSES[frame].R) < np.deg2rad(0.3)


def test_an_observation_far_from_its_point_makes_no_landmark():
    seen = seen_by_all()
    pixels = seen[4].pixels.copy()
    pixels[:30, 1] += 40  # away from the epipolar lines
    wrong = replace(seen[4], pixels=pixels, bearings=CAMERA.bearings(pixels))
    bundle = built([*seen[:4], wrong], (0, 4), range(5))
    assert isinstance(bundle, BundleSolution)
    assert set(bundle.problem.track_ids) <= set(seen[0].track_ids[30:])


def test_wrong_poses_are_a_failure_with_its_cause():
    turned = [*POSES[:4], Pose(rotation_from_vector(np.array([0.5, 0.0, 0.0])) @ POSES[4].R, POSES[4].t)]
    failed = built(seen_by_all(), (0, 4), (0, 4), turned)
    assert isinstance(failed, BundleFailure)
    assert "points can be triangulated" in failed.cause


def test_too_few_points_are_a_failure_with_its_cause():
    failed = built([view.at(np.arange(4)) for view in seen_by_all()], (0, 4), range(5))
    assert isinstance(failed, BundleFailure)
    assert failed.cause == "only 4 points can be triangulated"
