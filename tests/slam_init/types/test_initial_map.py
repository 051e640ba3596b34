"""The bearings that a frame has under the camera of a map."""

from dataclasses import replace

import numpy as np
from make_map import CAMERAS, make_map, make_observations

from slam_init.bundle.focal import camera_with_focal_factor


def test_a_frame_sees_the_landmarks_of_its_tracks():
    map_ = make_map()
    seen = make_observations(map_)[2]
    landmarks, features, bearings = map_.seen_in(seen)
    np.testing.assert_array_equal(map_.track_ids[landmarks], seen.track_ids[features])
    assert len(landmarks) == len(seen)
    np.testing.assert_array_equal(bearings, seen.bearings[features])


def test_bearings_belong_to_the_adjusted_focal_length():
    map_ = make_map()
    seen = make_observations(map_)[2]
    adjusted = camera_with_focal_factor(CAMERAS["pinhole"], 1.05)
    map_ = replace(map_, camera=adjusted, focal_factor=1.05, focal_factor_sigma=0.01)
    _, features, bearings = map_.seen_in(seen)
    np.testing.assert_allclose(bearings, adjusted.bearings(seen.pixels[features]), atol=1e-12)
    assert not np.allclose(bearings, seen.bearings[features])


def test_a_track_that_is_no_landmark_is_left_out():
    map_ = make_map()
    seen = make_observations(map_)[0]
    strange = replace(seen, track_ids=seen.track_ids + 1)
    landmarks, features, bearings = map_.seen_in(strange)
    assert len(landmarks) == len(features) == len(bearings) == 0
