"""Going on from the map: by resection alone, and with ISAM2 as the example does."""

import copy
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from runs import Fed

import slam_init.examples.continue_with_isam2 as continue_with_isam2_module
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.graph import calibration_key, pose_key
from slam_init.config import Config
from slam_init.continuation import Continuation, follow
from slam_init.errors import SourceError
from slam_init.examples.continue_with_isam2 import continue_with_isam2, main, position_errors
from slam_init.initializer import Initializer
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame


class Diary(Recorder):
    def __init__(self):
        self.frames, self.located = [], []

    def frame(self, frame, observations):
        self.frames.append(frame.index)

    def continued(self, keyframe):
        self.located.append(keyframe.frame)


def followed(fed, frames, count, recorder=None):
    return follow(fed.result.map, fed.tracker, iter(frames), count, recorder or Recorder())


@pytest.fixture(scope="module")
def room_refined_once(room):
    """A map made with a focal length stated a twentieth too long, and adjusted."""
    config = Config()
    config = replace(config, map=replace(config.map, refine_focal=True))
    initializer, frames = Initializer(camera_with_focal_factor(room.camera, 1.05), config), room.frames()
    for frame in frames:
        if initializer.process(frame):
            break
    return Fed(room, initializer.tracker, initializer.finish(), list(islice(frames, 15)))


@pytest.fixture
def room_refined(room_refined_once):
    return replace(room_refined_once, tracker=copy.deepcopy(room_refined_once.tracker))


def blank(index):
    return Frame(index, index / 30, "", np.full((480, 640), 90, np.uint8))


def test_the_next_frames_are_located_where_they_were_taken(room_fed):
    diary = Diary()
    continued = followed(room_fed, room_fed.following, 15, diary)
    assert [keyframe.frame for keyframe in continued.keyframes] == [frame.index for frame in room_fed.following]
    assert diary.frames == diary.located == [frame.index for frame in room_fed.following]
    errors = position_errors([*room_fed.result.map.keyframes, *continued.keyframes], room_fed.source.groundtruth)
    assert errors.max() < 0.03
    assert all(0.5 < share <= 1 for share in continued.survival)


def test_the_map_is_not_changed(room_fed):
    points = room_fed.result.map.points.copy()
    followed(room_fed, room_fed.following, 3)
    assert np.array_equal(room_fed.result.map.points, points)


def test_no_more_frames_are_taken_than_asked_for(room_fed):
    frames = iter(room_fed.following)
    continued = followed(room_fed, frames, 4)
    assert continued.frames == 4
    assert next(frames).index == room_fed.following[4].index


def test_a_video_that_ends_is_no_error(room_fed):
    assert followed(room_fed, room_fed.following[:2], 50).frames == 2
    assert followed(room_fed, [], 50).summary()["survival_median"] is None


def test_a_frame_that_sees_nothing_of_the_map_is_missing(room_fed):
    first = room_fed.following[0].index
    continued = followed(room_fed, [blank(first), blank(first + 1)], 2)
    assert continued.keyframes == ()
    assert continued.survival == (0.0, 0.0)
    assert continued.summary() == {"frames": 2, "located": 0, "survival_median": 0.0, "survival_last": 0.0}


def test_the_summary_counts():
    assert Continuation((), 0, ()).summary()["frames"] == 0
    assert Continuation((), 3, (1.0, 0.5, 0.25)).summary()["survival_median"] == 0.5
    assert Continuation((), 3, (1.0, 0.5, 0.25)).summary()["survival_last"] == 0.25


def test_isam2_goes_on_from_the_graph_of_the_map(room_fed):
    map_ = room_fed.result.map
    poses = continue_with_isam2(map_, room_fed.tracker, room_fed.following)
    assert [keyframe.frame for keyframe in poses] == [frame.index for frame in room_fed.following]
    assert position_errors([*map_.keyframes, *poses], room_fed.source.groundtruth).max() < 0.02
    assert not map_.values.exists(pose_key(poses[0].frame))  # the map itself stays as it was


def test_isam2_leaves_out_a_frame_that_it_cannot_locate(room_fed):
    first = room_fed.following[0].index
    assert continue_with_isam2(room_fed.result.map, room_fed.tracker, [blank(first)]) == []


def test_the_landmarks_come_out_of_the_values_in_the_order_of_the_map(room_fed):
    import gtsam

    map_ = room_fed.result.map
    np.testing.assert_allclose(gtsam.utilities.extractPoint3(map_.values), map_.points)


def test_the_example_tells_what_it_did(capsys):
    assert main(["synth:static?frames=4&width=320&height=240"]) == 3
    assert "static_camera" in capsys.readouterr().out
    assert main(["synth:nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_example_runs_from_frames_to_poses(room, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr(continue_with_isam2_module, "open_source", lambda name: opened.append(name) or room)
    assert main([]) == 0
    assert opened == ["synth:room"]
    out = capsys.readouterr().out
    assert "15 of the next 15 frames located" in out
    assert "ground truth" in out


def test_a_frame_that_cannot_be_read_ends_the_continuation_and_not_the_run(room_fed):
    def broken():
        yield room_fed.following[0]
        raise SourceError("000030.png is truncated")

    continued = followed(room_fed, broken(), 5)
    assert continued.frames == 1
    assert continued.ended_by == "000030.png is truncated"


def test_an_adjusted_focal_length_is_what_the_next_frames_are_located_with(room_refined):
    map_, true = room_refined.result.map, room_refined.source.camera
    assert abs(map_.camera.fx / true.fx - 1) < 0.025
    continued = followed(room_refined, room_refined.following, 15)
    assert len(continued.keyframes) == 15
    assert min(continued.survival) > 0.9
    errors = position_errors([*map_.keyframes, *continued.keyframes], room_refined.source.groundtruth)
    assert errors.max() < 0.01


def test_rays_are_those_of_the_camera_that_the_map_was_adjusted_with(room_fed, room_refined):
    for fed, adjusted in ((room_fed, False), (room_refined, True)):
        map_, seen = fed.result.map, fed.tracker.track(fed.following[0])
        landmarks, features, bearings = map_.seen_in(seen)
        assert np.array_equal(map_.track_ids[landmarks], seen.track_ids[features])
        np.testing.assert_allclose(bearings, map_.camera.bearings(seen.pixels[features]), atol=1e-12)
        assert np.array_equal(bearings, seen.bearings[features]) != adjusted


def test_isam2_goes_on_with_the_calibration_as_a_variable(room_refined):
    map_ = room_refined.result.map
    assert map_.values.exists(calibration_key())
    poses = continue_with_isam2(map_, room_refined.tracker, room_refined.following)
    assert [keyframe.frame for keyframe in poses] == [frame.index for frame in room_refined.following]
    assert position_errors([*map_.keyframes, *poses], room_refined.source.groundtruth).max() < 0.02
