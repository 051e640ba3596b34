"""Laws of an accepted map while further frames come: it grows until its depths are known, then it is final."""

import copy
from dataclasses import replace

import numpy as np

from slam_init.config import AcceptanceConfig, Config
from slam_init.initializer import Initializer
from slam_init.types.status import PoseKind, Status


def initialized(room, **options):
    """An initializer with a map, the frames after it, and the map."""
    initializer, frames = Initializer(room.camera, Config(**options)), room.frames()
    for frame in frames:
        if initializer.process(frame):
            return initializer, frames, initializer.map
    raise AssertionError


def test_a_map_whose_depths_are_not_known_grows_until_they_are(room):
    target = 0.15
    initializer, frames, accepted = initialized(room, acceptance=AcceptanceConfig(max_depth_sigma=target))
    assert accepted.depth_sigma > target
    assert initializer.status.refining
    for frame in frames:
        if not initializer.process(frame).refining:
            break
    assert initializer.map.depth_sigma <= target
    assert len(initializer.map.keyframes) > len(accepted.keyframes)
    assert initializer.result.frames_to_init == 10
    assert initializer.result.hypotheses == (initializer.map,)
    read = initializer.frames_read
    initializer.process(next(frames))
    assert initializer.frames_read == read


def test_without_frames_to_grow_by_a_map_is_handed_over_at_once(room):
    initializer, frames, accepted = initialized(room, refine_frames=0)
    assert not initializer.status.refining
    initializer.process(next(frames))
    assert initializer.map is accepted


def test_the_number_of_frames_is_the_callers_and_the_pose_of_each_is_reported_without_a_jump(room):
    initializer, frames, accepted = initialized(room, refine_frames=12)
    before, truth = initializer.status.pose, room.groundtruth
    first = truth.at(0.0)
    for k in range(1, 13):
        frame = next(frames)
        status = initializer.process(frame)
        assert status and status.refining == (k < 12)
        assert (initializer.map is accepted) == (k < 12)
        pose = status.pose
        assert pose.kind is PoseKind.MAP
        true = truth.at(frame.timestamp_s).R.T @ first.R
        assert np.degrees(np.arccos((np.trace(pose.cam_from_first @ true.T) - 1) / 2)) < 0.2
        step = before.cam_from_first @ pose.cam_from_first.T
        assert np.degrees(np.arccos(min((np.trace(step) - 1) / 2, 1.0))) < 1
        before = pose
    assert initializer.map.keyframes[-1].frame > accepted.keyframes[-1].frame


def test_an_end_exports_what_there_is_and_a_loss_is_reported(room):
    initializer, frames, accepted = initialized(room, refine_frames=1000)
    for _ in range(10):
        last = next(frames)
        initializer.process(last)
    assert initializer.map is accepted
    ended = copy.deepcopy(initializer)
    assert ended.finish().map.keyframes[-1].frame > accepted.keyframes[-1].frame
    assert not ended.status.refining
    blank = np.full_like(last.image, 90)
    status = Status()
    for k in range(1, 7):
        status = initializer.process(
            replace(last, index=last.index + k, timestamp_s=last.timestamp_s + k / 30, image=blank)
        )
    assert status
    assert status.lost_at == last.index + 1
    assert not status.refining
    assert any("lost at frame" in note for note in initializer.result.notes)
