"""Replayed tracks are those of a tracker that has run from the first frame on."""

import atexit
from itertools import takewhile

import numpy as np
from make_scene import texture, window
from make_source import GivenFrames, synth

from slam_init.compare import answers, replay
from slam_init.compare.replay import find_tracks
from slam_init.compare.trials import Settings
from slam_init.config import TrackingConfig
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera

CAMERA = Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5)


def test_replayed_tracks_give_the_same_map(tmp_path):
    room = synth("room", width=320, height=240, slow_start=1)
    by_images, by_tracks = Initializer(room.camera), Initializer(room.camera)
    count = 1 + sum(1 for _ in takewhile(lambda frame: not by_images.process(frame), room.frames()))
    given = GivenFrames(room.camera, tuple(room.frames(0, count)))
    for step in find_tracks(given, "room", tmp_path).steps(0):
        by_tracks.process_tracks(step.current, revised=step.revised)
    np.testing.assert_array_equal(by_tracks.map.points, by_images.map.points)


def test_revised_frames_are_replayed_at_the_frame_at_which_they_were_revised(tmp_path):
    image = texture(5, 700, 1000)
    frames = tuple(window(image, 120 * i, 40 * i, 320, 240, i) for i in range(3))
    steps = list(find_tracks(GivenFrames(CAMERA, frames), "photographs", tmp_path).steps(0))
    assert any(step.revised for step in steps)
    tracker = Tracker(CAMERA, TrackingConfig())
    for frame, step in zip(frames, steps, strict=True):
        np.testing.assert_array_equal(tracker.track(frame).pixels, step.current.pixels)
        assert [one.frame for one in tracker.revised] == [one.frame for one in step.revised]
        for ours, stored in zip(tracker.revised, step.revised, strict=True):
            np.testing.assert_array_equal(ours.track_ids, stored.track_ids)


def test_tracks_that_disappear_while_they_are_opened_are_made_anew(tmp_path, monkeypatch):
    """A worker on another machine takes the folder away when it ends."""
    source = GivenFrames(CAMERA, (window(texture(0, 240, 320), 0, 0, 320, 240),))
    (expected,) = find_tracks(source, "one frame", tmp_path / "kept").steps(0)
    folder = tmp_path / "taken"
    folder.mkdir()
    opened = replay._open
    taken = []

    def open_after_removal(home):
        if not taken:
            taken.append(home)
            answers._remove(folder)
        return opened(home)

    monkeypatch.setattr(replay, "_open", open_after_removal)
    (found,) = find_tracks(source, "one frame", folder).steps(0)
    assert taken
    np.testing.assert_array_equal(found.current.pixels, expected.current.pixels)
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("taken")] == ["taken"]


def test_a_worker_does_not_remove_a_folder_that_it_did_not_make(tmp_path, monkeypatch):
    registered = []
    monkeypatch.setattr(atexit, "register", lambda *call, **options: registered.append(call))
    answers._create_tracks_folder(Settings(tracks=str(tmp_path)))
    assert not registered
    answers._create_tracks_folder(Settings(tracks=str(tmp_path / "new")))
    assert registered
