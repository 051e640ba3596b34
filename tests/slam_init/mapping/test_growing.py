"""Laws of a map that goes on: it locates frames, gets keyframes and landmarks, keeps its frame, and can be lost."""

import copy
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from quest.geometry.quaternion import rotation_angle
from slam_init.mapping.growing import GrowingMap


@pytest.fixture(scope="module")
def grown(room_fed_once):
    """The room's map after the frames that follow it."""
    fed = replace(room_fed_once, tracker=copy.deepcopy(room_fed_once.tracker))
    growing = GrowingMap(fed.result.map)
    located = [growing.locate(fed.tracker.track(frame)) for frame in fed.following]
    return fed, located, growing.grown()


def test_keyframes_come_with_parallax_and_depths_get_better(grown):
    fed, _, map_ = grown
    accepted = fed.result.map
    assert len(map_.keyframes) > len(accepted.keyframes)
    assert map_.median_parallax_deg > 2 * accepted.median_parallax_deg
    assert map_.depth_sigma < 0.7 * accepted.depth_sigma


def test_frame_and_unit_stay(grown):
    fed, _, map_ = grown
    accepted = fed.result.map
    common, i, j = np.intersect1d(accepted.track_ids, map_.track_ids, return_indices=True)
    assert len(common) > 100
    np.testing.assert_allclose(map_.keyframes[0].world_from_cam.R, np.eye(3), atol=1e-5)
    ratio = np.linalg.norm(map_.points[j], axis=1) / np.linalg.norm(accepted.points[i], axis=1)
    # The unit was the depth of points that were known to this deviation.
    assert abs(np.log(np.median(ratio))) < accepted.depth_sigma


def test_gtsam_moves_no_camera_by_its_deviation(grown):
    *_, map_ = grown
    optimum = gtsam.LevenbergMarquardtOptimizer(map_.graph, map_.values).optimize()
    for keyframe, covariance in zip(map_.keyframes, map_.pose_covariances, strict=True):
        key = gtsam.symbol("x", keyframe.frame)
        step = map_.values.atPose3(key).localCoordinates(optimum.atPose3(key))
        assert np.all(np.abs(step) <= np.sqrt(np.diag(covariance)) + 1e-5)


def test_the_deviation_of_a_located_rotation_holds_its_error(grown):
    fed, located, _ = grown
    first = fed.source.groundtruth.at(fed.result.map.keyframes[0].timestamp_s)
    for one in located:
        truth = first.R.T @ fed.source.groundtruth.at(one.keyframe.timestamp_s).R
        error_deg = np.degrees(rotation_angle(truth.T @ one.keyframe.world_from_cam.R))
        assert error_deg < 3 * np.degrees(one.rotation_sigma_rad) < 3.0


def test_the_open_tracks_of_a_rolling_shutter_are_corrected_before_they_become_landmarks(room_fed):
    """The camera turns about y at one radian a second: the ray of a row is off by the time to the middle row."""
    map_, readout_s = room_fed.result.map, 0.02
    raw = replace(map_.open_tracks, turn_rad_s=np.array([0.0, 1.0, 0.0]))
    camera = map_.camera.with_readout(readout_s)
    view = GrowingMap(replace(map_, camera=camera, open_tracks=raw))._views[raw.frame]
    turned_rad = np.linalg.norm(np.cross(raw.bearings, view.bearings), axis=1)
    rows_s = readout_s * ((raw.pixels[:, 1] + 0.5) / camera.height - 0.5)
    across = np.linalg.norm(raw.bearings[:, [0, 2]], axis=1)
    np.testing.assert_allclose(turned_rad, np.abs(rows_s) * across, rtol=0.02, atol=1e-6)


def test_without_parallax_the_map_stays_the_accepted_one(room_fed):
    growing = GrowingMap(room_fed.result.map)
    seen = room_fed.tracker.track(room_fed.following[0])
    first = growing.locate(seen)
    again = growing.locate(seen)
    assert growing.grown() is room_fed.result.map
    np.testing.assert_allclose(first.keyframe.world_from_cam.t, again.keyframe.world_from_cam.t, atol=1e-6)


def test_a_pose_that_too_few_landmarks_agree_with_has_no_deviation(room_fed):
    map_, seen = room_fed.result.map, room_fed.tracker.track(room_fed.following[0])
    growing, landmarks = GrowingMap(map_), np.flatnonzero(np.isin(seen.track_ids, map_.track_ids))
    assert growing.locate(seen.at(landmarks[:10])).rotation_sigma_rad == np.pi
    assert growing.locate(replace(seen, frame=seen.frame + 1)).rotation_sigma_rad < 0.02


def half_of(map_):
    """A map with half of its landmarks, and the tracks of the others."""
    kept = np.arange(len(map_.points)) % 2 == 0
    of_kept, place = kept[map_.observation_landmarks], np.cumsum(kept) - 1
    half = replace(
        map_,
        points=map_.points[kept],
        track_ids=map_.track_ids[kept],
        observation_keyframes=map_.observation_keyframes[of_kept],
        observation_landmarks=place[map_.observation_landmarks[of_kept]],
        observation_pixels=map_.observation_pixels[of_kept],
    )
    return half, map_.track_ids[~kept]


def after_a_keyframe(map_, seen, revised=()):
    growing = GrowingMap(map_)
    for one in seen:
        growing.locate(one, revised)
        if growing.keyframes_added:
            break
    return growing.grown()


def test_points_that_descriptors_find_in_earlier_keyframes_become_landmarks_at_once(room_fed):
    """The other half is stated to be seen by the keyframes of the map, or not."""
    history = list(room_fed.tracker.history)
    half, others = half_of(room_fed.result.map)
    seen = [room_fed.tracker.track(frame) for frame in room_fed.following]
    assert not np.isin(others, after_a_keyframe(half, seen).track_ids).any()
    assert np.isin(others, after_a_keyframe(half, seen, history).track_ids).mean() > 0.5


def test_a_frame_that_sees_few_landmarks_again_becomes_a_keyframe(room_fed):
    """Half of the landmarks leave the view before the parallax reaches a degree."""
    growing = GrowingMap(room_fed.result.map)
    seen = room_fed.tracker.track(room_fed.following[0])
    growing.locate(seen)
    assert growing.keyframes_added == 0
    in_view = np.isin(seen.track_ids, room_fed.result.map.track_ids)
    left = seen.at(np.flatnonzero(in_view)[::2])
    growing.locate(replace(left, frame=seen.frame + 1))
    assert growing.keyframes_added == 1
