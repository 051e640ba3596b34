"""The bearings that a frame has under the camera of a map, and the two parts of its risk."""

from dataclasses import replace

import numpy as np
from make_map import make_map, make_observations

from slam_init.types.initial_map import UNMODELLED_RISK

MAP = make_map()
SEEN = make_observations(MAP)[2]


def test_a_frame_sees_the_landmarks_of_its_tracks_and_no_others():
    landmarks, features, bearings = MAP.seen_in(SEEN)
    np.testing.assert_array_equal(MAP.track_ids[landmarks], SEEN.track_ids[features])
    assert len(landmarks) == len(SEEN)
    np.testing.assert_array_equal(bearings, SEEN.bearings[features])
    assert [len(part) for part in MAP.seen_in(replace(SEEN, track_ids=SEEN.track_ids + 1))] == [0, 0, 0]


def test_a_map_is_never_safer_than_the_rate_of_causes_that_no_model_has_if_it_states_a_risk():
    for model in (0.0, 0.001, 0.005):
        assert replace(MAP, model_risk=model).risk == model + UNMODELLED_RISK
    assert replace(MAP, model_risk=1.0).risk == 1.0
    assert replace(MAP, model_risk=None).risk is None
