"""The keyframe manager: scores of pairs, waiting times after failures, and a bounded window of candidates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.frontend.keyframes import KeyframeManager, PairPreview, preview_pairs
from slam_init.types.pose import Pose

NOISE_PX = CONFIG.map.noise_px


def preview(poses, noise_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    a, b = observe(CAMERA, poses, cloud(rng), noise_px, rng)
    return preview_pairs(CAMERA, [a], b, NOISE_PX)[0]


def pair(reference, current, matches=100, parallax_px=10.0, spread=1.0):
    return PairPreview(matches, 20.0, 1.0, parallax_px, 1.0, spread, reference, current, 1.0)


@given(turn=st.tuples(*[st.floats(-0.15, 0.15)] * 3))
@settings(max_examples=20)
def test_a_pure_rotation_has_no_parallax(turn):
    rotated = preview([Pose.identity(), Pose(rotation_from_vector(np.array(turn)), np.zeros(3))])
    assert rotated.parallax_px < 0.01
    assert rotated.parallax_share == 0
    assert rotated.rotation_deg == pytest.approx(np.rad2deg(np.linalg.norm(turn)), abs=0.05)


def test_parallax_is_proportional_to_the_translation():
    """A translation by t parallel to the image moves a point at depth z by f t / z, less the best rotation."""
    near, far = (preview([Pose.identity(), Pose(np.eye(3), np.array([t, 0, 0]))]) for t in (0.05, 0.1))
    assert 0 < near.parallax_px < 0.05 * CAMERA.fx / 0.8
    assert far.parallax_px == pytest.approx(2 * near.parallax_px, rel=0.15)
    assert far.direction_score > near.direction_score


def test_a_pair_without_common_tracks_has_score_0():
    a, b = observe(CAMERA, make_poses(2), cloud(np.random.default_rng(0)))
    (unrelated,) = preview_pairs(CAMERA, [a], replace(b, track_ids=b.track_ids + 1), NOISE_PX)
    assert unrelated.matches == 0
    assert unrelated.direction_score == 0
    empty = b.at(np.arange(0))
    assert preview_pairs(CAMERA, [empty], empty, NOISE_PX)[0].direction_score == 0


def drive(poses, steps_px=None):
    """The candidates of a manager after each frame, whose tracks have these standard deviations."""
    manager, windows = KeyframeManager(CONFIG), []
    seen = observe(CAMERA, poses, cloud(np.random.default_rng(1)))
    if steps_px is not None:
        seen = [replace(one, step_px=step_px) for one, step_px in zip(seen, steps_px, strict=True)]
    history = history_of(seen)
    for current in seen:
        manager.update(current, manager.preview(history, current))
        windows.append(list(manager.candidates))
    return windows


def test_the_window_is_bounded_and_holds_each_frame_once():
    settings = CONFIG.keyframes
    static = [Pose.identity()] * (settings.new_after_frames * (settings.window + 3))
    windows = drive(static)
    assert windows[0] == [0]
    assert max(len(window) for window in windows) == settings.window
    assert all(len(set(window)) == len(window) for window in windows)
    assert windows[-1][-1] > windows[0][-1]


def test_candidates_are_dropped_at_an_age_at_which_tracks_have_drifted():
    """Drift looks like parallax, so that the score alone would never drop the oldest frame."""
    moved = Pose(np.eye(3), np.array([0.1, 0, 0]))
    windows = drive([Pose.identity()] + [moved] * 350)
    assert 0 in windows[250]
    assert all(frame - min(window) <= 300 + CONFIG.keyframes.new_after_frames for frame, window in enumerate(windows))


def candidates_with_steps(steps_px):
    """The candidates of a static camera after these frames."""
    return drive([Pose.identity()] * len(steps_px), steps_px)[-1]


def test_a_blurred_frame_is_no_candidate_while_the_next_frames_will_do():
    due = CONFIG.keyframes.new_after_frames
    sharp = [0.1] * 40
    assert candidates_with_steps(sharp)[1:3] == [due, 2 * due]
    blurred = sharp.copy()
    blurred[due : due + 3] = [0.2] * 3
    assert candidates_with_steps(blurred)[1] == due + 3
    # A video that is blurred from some frame on has candidates again.
    lasting = [0.1] * due + [0.2] * 30
    assert due < candidates_with_steps(lasting)[1] <= 2 * due


def test_the_wait_is_doubled_after_each_failure_without_a_higher_score():
    """The camera stops after too short a baseline. With equal waits a full window would cost one attempt per frame."""
    settings = CONFIG.keyframes
    manager = KeyframeManager(CONFIG)
    tried = []
    for frame in range(1, 64 * settings.new_after_frames):
        if (chosen := manager.best_pair_to_try([pair(0, frame)])) is not None:
            manager.failed(chosen)
            tried.append(frame)
    waits = np.diff(tried)
    assert waits[0] == 1
    # The wait is doubled each time, up to a few seconds of video.
    assert (waits[1:] == np.minimum(2 * waits[:-1], 8 * settings.new_after_frames)).all()
    # A higher score ends the wait at once, and the next wait is short again.
    more = pair(0, frame + 1, parallax_px=10.1 * settings.retry_gain)
    assert manager.best_pair_to_try([more]) is more
    manager.failed(more)
    assert manager.best_pair_to_try([replace(more, current=more.current + settings.new_after_frames)]) is not None
