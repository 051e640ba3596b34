"""Replayed tracks are those of a tracker that has run from the first frame on."""

import numpy as np
import pytest
from make_scene import texture, window
from make_source import GivenFrames
from path_types import PATH_TYPES

from slam_init.compare.replay import find_tracks
from slam_init.config import TrackingConfig
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera

CAMERA = Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5)


def test_replayed_tracks_give_the_same_map(room, room_run, tmp_path):
    frames = tuple(room.frames(0, room_run.result.frames_to_init))
    initializer = Initializer(room.camera)
    for step in find_tracks(GivenFrames(room.camera, frames), "room", tmp_path).steps(0):
        initializer.process_tracks(step.current, step.revised)
    np.testing.assert_array_equal(initializer.map.points, room_run.result.map.points)


def test_revised_frames_are_replayed_at_the_frame_at_which_they_were_revised(tmp_path):
    image = texture(5, 700, 1000)
    frames = tuple(window(image, 120 * i, 40 * i, 320, 240, i) for i in range(4))
    steps = list(find_tracks(GivenFrames(CAMERA, frames), "photographs", tmp_path).steps(0))
    assert any(step.revised for step in steps)
    tracker = Tracker(CAMERA, TrackingConfig())
    for frame, step in zip(frames, steps, strict=True):
        np.testing.assert_array_equal(tracker.track(frame).pixels, step.current.pixels)
        assert [one.frame for one in tracker.revised] == [one.frame for one in step.revised]
        for ours, stored in zip(tracker.revised, step.revised, strict=True):
            np.testing.assert_array_equal(ours.track_ids, stored.track_ids)


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_stored_tracks_are_opened_by_a_path_of_any_type(path_type, tmp_path):
    source = GivenFrames(CAMERA, (window(texture(0, 240, 320), 0, 0, 320, 240),))
    (first,) = find_tracks(source, "one frame", tmp_path).steps(0)
    (again,) = find_tracks(source, "one frame", path_type(tmp_path)).steps(0)
    np.testing.assert_array_equal(first.current.pixels, again.current.pixels)
