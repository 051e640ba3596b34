"""Laws of the frames after the initialization: located in the map by resection, which does not change the map."""

from dataclasses import replace

import numpy as np
import pytest
from continue_with_isam2 import position_errors

from slam_init import Follower, SlamInitError
from slam_init.mapping.follower import follow
from slam_init.output.summary import ContinuationRecord
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame


class Diary(Recorder):
    """Keeps the reports of the continuation."""

    def __init__(self):
        self.frames, self.located = [], []

    def frame(self, frame, observations):
        self.frames.append(frame.index)

    def continued(self, keyframe):
        self.located.append(keyframe.frame)


def followed(fed, frames, count, recorder=None):
    return follow(fed.result.map, fed.tracker, iter(frames), count, recorder or Recorder())


def blank(index):
    return Frame(index, index / 30, "", np.full((480, 640), 90, np.uint8))


def test_the_next_frames_are_located_where_they_were_taken(room_fed):
    diary, points = Diary(), room_fed.result.map.points.copy()
    continued = followed(room_fed, room_fed.following, 15, diary)
    assert np.array_equal(room_fed.result.map.points, points)
    assert [keyframe.frame for keyframe in continued.keyframes] == [frame.index for frame in room_fed.following]
    assert diary.frames == diary.located == [frame.index for frame in room_fed.following]
    errors = position_errors([*room_fed.result.map.keyframes, *continued.keyframes], room_fed.source.groundtruth)
    assert errors.max() < 0.03
    assert all(0.5 < share <= 1 for share in continued.survival)


def test_a_follower_locates_the_frames_of_an_initializer_one_by_one(room_fed):
    """It refuses what is no next frame of the camera, and goes on."""
    follower, (first, second, *_) = Follower(room_fed.result.map, room_fed.tracker), room_fed.following
    located = [follower.locate(first)]
    for wrong in (None, first.image, first, replace(second, image=second.image[::2, ::2])):
        with pytest.raises(SlamInitError) as message:
            follower.locate(wrong)
        assert "\n" not in str(message.value)
    located.append(follower.locate(second))
    assert follower.located == located and len(follower.survival) == 2 and follower.lost_at is None
    assert position_errors([*room_fed.result.map.keyframes, *located], room_fed.source.groundtruth).max() < 0.03
    assert len(follower.map.points) >= len(room_fed.result.map.points)
    for wrong in ((None, room_fed.tracker), (room_fed.result, room_fed.tracker), (room_fed.result.map, None)):
        with pytest.raises(SlamInitError, match="give"):
            Follower(*wrong)


def test_no_more_frames_are_taken_than_asked_for(room_fed):
    frames = iter(room_fed.following)
    continued = followed(room_fed, frames, 4)
    assert continued.frames == 4
    assert next(frames).index == room_fed.following[4].index


def test_the_end_of_a_video_is_not_an_error(room_fed):
    assert followed(room_fed, room_fed.following[:2], 50).frames == 2
    assert followed(room_fed, [], 50).record().survival_median is None


def test_a_frame_that_sees_no_landmark_is_not_located(room_fed):
    first = room_fed.following[0].index
    continued = followed(room_fed, [blank(first), blank(first + 1)], 2)
    assert continued.keyframes == ()
    assert continued.survival == (0.0, 0.0)
    assert continued.record() == ContinuationRecord(frames=2, located=0, survival_median=0.0, survival_last=0.0)


def test_the_rays_of_a_frame_are_those_of_the_camera_of_the_map(room_fed, room_refined):
    for fed, adjusted in ((room_fed, False), (room_refined, True)):
        map_, seen = fed.result.map, fed.tracker.track(fed.following[0])
        landmarks, features, bearings = map_.seen_in(seen)
        assert np.array_equal(map_.track_ids[landmarks], seen.track_ids[features])
        np.testing.assert_allclose(bearings, map_.camera.bearings(seen.pixels[features]), atol=1e-12)
        assert np.array_equal(bearings, seen.bearings[features]) != adjusted
