"""The pose of the newest camera: from the second frame on, what it is, and no jump where the map begins."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_map
from make_window import point_source

from quest.geometry.quaternion import rotation_angle
from slam_init import Initializer
from slam_init.decision.current_pose import CurrentPose
from slam_init.types.history import History
from slam_init.types.status import PoseKind


def poses(source):
    """The status after each frame, and the true rotation of each frame from the first."""
    initializer, statuses, truth = Initializer(source.camera), [], []
    first = None
    for observed in source.observations():
        statuses.append(initializer.process_tracks(observed))
        world_from_cam = source.groundtruth.at(observed.timestamp_s)
        first = first or world_from_cam
        truth.append(world_from_cam.R.T @ first.R)
        if statuses[-1]:
            break
    return initializer, statuses, truth


def errors_deg(statuses, truth):
    found = [status.pose.cam_from_first @ R.T for status, R in zip(statuses[1:], truth[1:], strict=True)]
    return np.degrees([rotation_angle(R) for R in found])


def test_each_frame_but_the_first_has_a_rotation_near_the_true_one():
    _, statuses, truth = poses(point_source("room", 0, baseline=0.3, views=40))
    assert statuses[0].pose is None
    errors = errors_deg(statuses, truth)
    assert errors.max() < 0.5
    # The parallax that a rotation takes up is in its deviation.
    assert np.all(errors < 2 * np.array([status.pose.rotation_sigma_deg for status in statuses[1:]]))


def test_the_map_begins_without_a_jump_and_its_pose_is_that_of_the_keyframe():
    initializer, statuses, truth = poses(point_source("room", 1, baseline=0.3, views=40))
    pose, map_ = statuses[-1].pose, initializer.map
    assert pose.kind == PoseKind.MAP
    assert pose.reference == map_.keyframes[0].frame
    last = map_.keyframes[-1].world_from_cam
    assert np.linalg.norm(pose.centre) == np.linalg.norm(last.t - map_.keyframes[0].world_from_cam.t)
    errors = errors_deg(statuses, truth)
    assert abs(errors[-1] - errors[-2]) < 1.0


def test_a_camera_that_only_turns_has_a_rotation_and_no_centre():
    _, statuses, truth = poses(point_source("rotation", 0, views=30))
    assert not any(statuses)
    assert {status.pose.kind for status in statuses[1:]} == {PoseKind.ROTATION}
    assert all(status.pose.centre is None for status in statuses[1:])
    assert max(status.pose.rotation_sigma_deg for status in statuses[1:]) < 1.0
    assert errors_deg(statuses, truth).max() < 0.5


@pytest.mark.slow
def test_the_deviation_knows_that_a_wall_has_two_motions():
    """The motion that fits best may be the wrong one; its rotation is off by some degrees then."""
    _, statuses, truth = poses(point_source("wall", 0, baseline=0.3, views=40))
    errors = errors_deg(statuses, truth)
    assert errors.max() > 1
    assert np.all(errors < 3 * np.array([status.pose.rotation_sigma_deg for status in statuses[1:]]))


def test_after_a_cut_there_is_no_pose_and_the_first_camera_stays_the_first():
    source = point_source("rotation", 0, views=12)
    history, pose, seen = History(source.camera, 2), CurrentPose(), list(source.observations())
    found = []
    for k, observed in enumerate(seen):
        after = replace(observed, track_ids=observed.track_ids + (0 if k < 5 else 10_000))
        history.add(after)
        found.append(pose.update(history, after, None, None))
        history.forget(keep=())
    assert [one is None for one in found] == [True, *[False] * 4, *[True] * 7]
    map_ = make_map("pinhole")
    start = pose.located(map_, map_.keyframes[0], 0.1)
    np.testing.assert_allclose(start.cam_from_first, np.eye(3), atol=1e-9)
    assert start.reference == map_.keyframes[0].frame
