"""The recorder that ignores all reports."""

from __future__ import annotations

import inspect
from dataclasses import replace

from make_map import make_attempts, make_frame, make_map, make_observations
from report_run import report_run

from slam_init.recording.recorder import Recorder, StoryRecorder
from slam_init.recording.rerun_recorder import RerunRecorder


def test_a_recorder_takes_all_reports_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report_run(Recorder())
    assert list(tmp_path.iterdir()) == []


def test_all_recorders_have_the_same_reports():
    for name, method in inspect.getmembers(Recorder, inspect.isfunction):
        if name in vars(RerunRecorder) and name != "__init__":
            assert inspect.signature(method) == inspect.signature(getattr(RerunRecorder, name))


# -- the story of a run ----------------------------------------------------------------------------


def test_of_a_long_run_the_last_frames_are_kept():
    recorder = StoryRecorder()
    first, image = make_observations(make_map())[0], make_frame(0, 0.0, "a.png")
    for index in range(100, 520):
        recorder.frame(replace(image, index=index), replace(first, frame=index, timestamp_s=index / 30))
    assert [shown.index for shown in recorder.frames] == list(range(120, 520))


def test_of_an_initialized_run_the_keyframes_and_the_pair_are_kept_and_nothing_of_later_maps():
    recorder = StoryRecorder()
    map_ = report_run(recorder)
    pair = recorder.pair
    recorder.restarted()
    recorder.attempt(make_attempts(map_)[0])
    recorder.initialized(replace(map_, keyframes=map_.keyframes[:1]), ())
    assert [shown.index for shown in recorder.frames] == [keyframe.frame for keyframe in map_.keyframes]
    assert recorder.pair is pair and pair[2].frames == (10, 31)
    assert pair[2].evaluated
