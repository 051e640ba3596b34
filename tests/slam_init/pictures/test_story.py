"""What is kept of a run for its picture: few frames in bounded memory, the keyframes of a map, the last pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from make_map import make_attempts, make_frame, make_map, make_observations
from report_run import report_run

from slam_init.pictures.overview import StoryRecorder


def seen(recorder, frames):
    first = make_observations(make_map())[0]
    image = make_frame(0, 0.0, "a.png")
    for index in frames:
        recorder.frame(replace(image, index=index), replace(first, frame=index, timestamp_s=index / 30))


def test_of_a_long_run_a_few_evenly_spaced_frames_are_kept_with_the_first_and_the_last():
    for count in (1, 2, 16, 17, 500):
        recorder = StoryRecorder()
        seen(recorder, range(100, 100 + count))
        indices = [shown.index for shown in recorder.story().frames]
        assert indices[0] == 100 and indices[-1] == 99 + count
        assert len(indices) <= 17
        steps = np.diff(indices[:-1])
        assert len(set(steps)) <= 1


def test_of_an_initialized_run_the_keyframes_are_kept_and_no_later_frame():
    recorder = StoryRecorder()
    map_ = report_run(recorder)
    story = recorder.story()
    assert [shown.index for shown in story.frames] == [keyframe.frame for keyframe in map_.keyframes]
    assert story.pair.attempt.frames == (10, 31)
    assert story.pair.attempt.judged


def test_without_an_estimated_pair_the_first_and_the_last_frame_are_shown_with_their_common_tracks():
    recorder = StoryRecorder()
    assert recorder.story().pair is None
    seen(recorder, (3, 4, 9))
    attempt = make_attempts(make_map())[0]
    none = np.zeros((0, 2))
    recorder.attempt(replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool)))
    pair = recorder.story().pair
    assert pair.attempt.frames == (3, 9)
    assert len(pair.attempt.pixels1) == len(make_observations(make_map())[0])
    assert not pair.attempt.judged
