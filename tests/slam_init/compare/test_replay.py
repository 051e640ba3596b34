"""Replayed tracks are those of a tracker that has run from the first frame on."""

from dataclasses import replace

import numpy as np
from make_scene import texture, window
from make_source import GivenFrames

from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.config import TrackingConfig
from slam_init.frontend.tracks import Tracker
from slam_init.types.camera import Camera

CAMERA = Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5)


def test_revised_frames_are_replayed_at_the_frame_at_which_they_were_revised(tmp_path):
    image = texture(5, 700, 1000)
    frames = tuple(window(image, 120 * i, 40 * i, 320, 240, i) for i in range(3))
    steps = list(replay(GivenFrames(CAMERA, frames), "photographs", 0, tmp_path))
    assert any(step.revised for step in steps)
    tracker = Tracker(CAMERA, TrackingConfig())
    for frame, step in zip(frames, steps, strict=True):
        np.testing.assert_array_equal(tracker.track(frame).pixels, step.current.pixels)
        assert [one.frame for one in tracker.revised] == [one.frame for one in step.revised]
        for ours, stored in zip(tracker.revised, step.revised, strict=True):
            np.testing.assert_array_equal(ours.track_ids, stored.track_ids)


def test_stored_tracks_are_not_computed_again_and_start_where_they_are_asked_to(tmp_path):
    image = texture(5, 240, 400)
    source = GivenFrames(CAMERA, tuple(window(image, 10 * i, 0, 320, 240, i) for i in range(4)))
    whole = list(replay(source, "clip", 0, tmp_path))
    (file,) = tmp_path.iterdir()
    stamp = file.stat().st_mtime_ns
    part = list(replay(source, "clip", 2, tmp_path))
    assert file.stat().st_mtime_ns == stamp
    assert [step.current.frame for step in part] == [2, 3]
    for ours, theirs in zip(part, whole[2:], strict=True):
        np.testing.assert_array_equal(ours.current.pixels, theirs.current.pixels)


def test_a_digest_changes_with_the_tracks_and_not_with_the_last_bit():
    source = open_compared("points:room?views=4&seed=1")
    steps = list(replay(source, "", 0, ""))
    digest = tracks_digest(source, "", steps)

    def moved(by):
        current = steps[2].current
        return [*steps[:2], replace(steps[2], current=replace(current, pixels=current.pixels + by)), steps[3]]

    assert tracks_digest(source, "", moved(1e-12)) == digest
    assert len({digest, tracks_digest(source, "", moved(0.5)), tracks_digest(source, "", steps[:3])}) == 3
