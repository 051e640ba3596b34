"""The keyframe manager: what a pair promises, and a window of candidates that stays bounded."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.frontend.keyframes import KeyframeManager, PairPreview, preview_pair
from slam_init.types.pose import Pose

NOISE_PX = CONFIG.map.noise_px
TURN = rotation_from_vector(np.array([0.01, 0.04, 0.02]))


def preview(poses, noise_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    a, b = observe(CAMERA, poses, cloud(rng), noise_px, rng)
    return preview_pair(CAMERA, a, b, NOISE_PX)


def pair(reference, current, matches=100, parallax_px=10.0, spread=1.0):
    return PairPreview(reference, current, matches, 1.0, 20.0, 1.0, parallax_px, 1.0, spread)


@given(turn=st.tuples(*[st.floats(-0.15, 0.15)] * 3))
@settings(max_examples=20, deadline=None)
def test_a_pure_rotation_has_no_parallax(turn):
    still = preview([Pose.identity(), Pose(rotation_from_vector(np.array(turn)), np.zeros(3))])
    assert still.parallax_px < 0.01
    assert still.parallax_share == 0
    assert still.rotation_deg == pytest.approx(np.rad2deg(np.linalg.norm(turn)), abs=0.05)


def test_the_noise_of_a_pure_rotation_is_no_parallax():
    noisy = preview([Pose.identity(), Pose(TURN, np.zeros(3))], 0.5 * NOISE_PX)
    assert noisy.motion_px > 10
    assert noisy.parallax_share < 0.05


def test_a_still_camera_has_no_motion():
    assert preview([Pose.identity()] * 2, 0.2).motion_px < 1


def test_parallax_is_what_the_translation_moves():
    """A plane-parallel shift by t moves a point at depth z by f t / z; the best rotation takes its mean away."""
    near, far = (preview([Pose.identity(), Pose(np.eye(3), np.array([t, 0, 0]))]) for t in (0.05, 0.1))
    assert 0 < near.parallax_px < 0.05 * CAMERA.fx / 0.8
    assert far.parallax_px == pytest.approx(2 * near.parallax_px, rel=0.15)
    assert far.promise > near.promise


def test_a_rotation_on_top_does_not_change_the_parallax():
    plain = preview([Pose.identity(), Pose(np.eye(3), np.array([0.1, 0, 0]))])
    turned = preview([Pose.identity(), Pose(TURN, np.array([0.1, 0, 0]))])
    assert turned.parallax_px == pytest.approx(plain.parallax_px, rel=0.15)


def test_a_pair_without_common_tracks_promises_nothing():
    a, b = observe(CAMERA, make_poses(2), cloud(np.random.default_rng(0)))
    strangers = preview_pair(CAMERA, a, replace(b, track_ids=b.track_ids + 1), NOISE_PX)
    assert strangers.matches == 0
    assert strangers.promise == 0
    empty = replace(b, track_ids=b.track_ids[:0], pixels=b.pixels[:0], bearings=b.bearings[:0])
    assert preview_pair(CAMERA, empty, empty, NOISE_PX).promise == 0


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (pair(0, 9, parallax_px=20), pair(0, 9)),
        (pair(0, 9, matches=400), pair(0, 9)),
        (pair(0, 9), pair(0, 9, spread=0.1)),
    ],
)
def test_more_parallax_tracks_and_spread_promise_more(better, worse):
    assert better.promise > worse.promise


def drive(poses, manager=None):
    """Feed a manager; its window after each frame."""
    manager = manager or KeyframeManager(CAMERA, CONFIG)
    seen = observe(CAMERA, poses, cloud(np.random.default_rng(1)))
    history = history_of(seen)
    windows = []
    for current in seen:
        manager.update(current, manager.preview(history, current))
        windows.append(list(manager.candidates))
    return windows


def test_the_window_stays_bounded_and_holds_frames_once():
    settings = CONFIG.keyframes
    still = [Pose.identity()] * (settings.new_after_frames * (settings.window + 3))
    windows = drive(still)
    assert windows[0] == [0]
    assert max(len(window) for window in windows) == settings.window
    assert all(len(set(window)) == len(window) for window in windows)
    assert windows[-1][-1] > windows[0][-1]


def test_a_candidate_that_promises_is_kept_over_one_that_does_not():
    """A camera that stands still after it moved: the view from before the motion is the one of use."""
    settings = CONFIG.keyframes
    still = settings.new_after_frames * (settings.window + 3)
    moved = Pose(np.eye(3), np.array([0.1, 0, 0]))
    windows = drive([Pose.identity()] + [moved] * still)
    assert 0 in windows[-1]


def test_no_candidate_grows_so_old_that_its_tracks_have_drifted():
    """Drift looks like parallax, so the promise alone would keep the oldest frame for ever."""
    moved = Pose(np.eye(3), np.array([0.1, 0, 0]))
    windows = drive([Pose.identity()] + [moved] * 350)
    assert 0 in windows[250]
    assert all(frame - min(window) <= 300 + CONFIG.keyframes.new_after_frames for frame, window in enumerate(windows))


def test_a_new_candidate_waits_for_what_its_neighbour_lacked():
    """Each candidate of a window sees the same scene: one failure is not repeated for each of them."""
    settings = CONFIG.keyframes
    manager = KeyframeManager(CAMERA, CONFIG)
    first = 100
    manager.update(replace(observe(CAMERA, [Pose.identity()], cloud(np.random.default_rng(1)))[0], frame=first), [])
    manager.failed(pair(first, first + 9))
    second = first + settings.new_after_frames
    current = replace(observe(CAMERA, [Pose.identity()], cloud(np.random.default_rng(1)))[0], frame=second)
    manager.update(current, [pair(first, second)])
    assert manager.candidates == [first, second]
    assert manager.worth_trying([pair(second, second + 1)]) is None
    assert manager.worth_trying([pair(second, second + 1, parallax_px=10.1 * settings.retry_gain)]) is not None
    # Nor is it tried before it is as old as its neighbour was when it became one.
    assert manager.worth_trying([pair(second, second + settings.new_after_frames)]) is not None
    # Another scene is another matter.
    third = second + settings.new_after_frames
    manager.update(replace(current, frame=third), [replace(pair(k, third), overlap=0.1) for k in manager.candidates])
    assert manager.worth_trying([pair(third, third + 1)]) is not None


def test_a_frame_without_features_makes_room_for_the_next():
    """The first frame after a cut or a dark one shares its few tracks with the next, which has many more."""
    poor, rich = observe(CAMERA, [Pose.identity()] * 2, cloud(np.random.default_rng(1)))
    poor = replace(poor, track_ids=poor.track_ids[:5], pixels=poor.pixels[:5], bearings=poor.bearings[:5])
    manager = KeyframeManager(CAMERA, CONFIG)
    history = history_of([poor, rich])
    for current in (poor, rich):
        manager.update(current, manager.preview(history, current))
    assert manager.candidates == [0, 1]


def test_pairs_come_in_the_order_of_their_promise():
    poses = make_poses(4)
    seen = observe(CAMERA, poses, cloud(np.random.default_rng(2)))
    manager = KeyframeManager(CAMERA, CONFIG)
    manager.candidates[:] = [0, 1, 2]
    pairs = manager.preview(history_of(seen), seen[3])
    assert [pair.reference for pair in pairs] == [0, 1, 2]  # the camera moves on, so the oldest promises most
    assert manager.worth_trying(pairs) is pairs[0]


def test_too_few_matches_are_not_worth_a_try():
    manager = KeyframeManager(CAMERA, CONFIG)
    few, enough = CONFIG.keyframes.min_matches - 1, CONFIG.keyframes.min_matches
    assert manager.worth_trying([]) is None
    assert manager.worth_trying([pair(0, 5, matches=few)]) is None
    assert manager.worth_trying([pair(0, 5, matches=few), pair(1, 5, matches=enough)]).reference == 1


def test_a_failed_pair_waits_until_it_promises_more_or_time_has_passed():
    settings = CONFIG.keyframes
    manager = KeyframeManager(CAMERA, CONFIG)
    manager.failed(pair(0, 20, parallax_px=10))
    assert manager.worth_trying([pair(0, 21, parallax_px=10)]) is None
    assert manager.worth_trying([pair(0, 21, parallax_px=10.1 * settings.retry_gain)]) is not None
    assert manager.worth_trying([pair(0, 20 + settings.new_after_frames, parallax_px=10)]) is not None
    other = pair(1, 21, parallax_px=5)
    assert manager.worth_trying([pair(0, 21, parallax_px=10), other]) is other


def test_in_a_steady_motion_a_pair_is_tried_again_when_its_way_is_as_long_as_it_must_be():
    """The promise of little parallax is noise and hardly grows; the way does."""
    lacking = 2.0
    manager = KeyframeManager(CAMERA, CONFIG)
    manager.failed(pair(0, 10), lacking=lacking)
    waited = [frame for frame in range(11, 20) if manager.worth_trying([pair(0, frame)]) is None]
    # Four fifths of the way, as for the promise.
    assert len(waited) + 11 == round(0.8 * lacking * 10)


def test_a_pair_that_failed_by_far_waits_for_more_than_one_that_failed_just_so():
    settings = CONFIG.keyframes
    just, far, hopeless = (KeyframeManager(CAMERA, CONFIG) for _ in range(3))
    just.failed(pair(0, 5, parallax_px=10), lacking=1.0)
    far.failed(pair(0, 5, parallax_px=10), lacking=2.5)
    hopeless.failed(pair(0, 5, parallax_px=10), lacking=float("inf"))
    little_more = [pair(0, 6, parallax_px=10.1 * settings.retry_gain)]
    assert just.worth_trying(little_more) is not None
    assert far.worth_trying(little_more) is None
    assert far.worth_trying([pair(0, 6, parallax_px=25)]) is not None
    # The scene may change: there is a promise at which every pair is looked at again.
    assert hopeless.worth_trying([pair(0, 6, parallax_px=9.9 * settings.max_retry_gain)]) is None
    assert hopeless.worth_trying([pair(0, 6, parallax_px=10.1 * settings.max_retry_gain)]) is not None


def test_a_pair_that_never_promises_more_is_tried_ever_more_seldom():
    """A camera that stopped after too short a way: a full window tried in turns would take an attempt a frame."""
    settings = CONFIG.keyframes
    manager = KeyframeManager(CAMERA, CONFIG)
    tried = []
    for frame in range(1, 64 * settings.new_after_frames):
        if (chosen := manager.worth_trying([pair(0, frame)])) is not None:
            manager.failed(chosen)
            tried.append(frame)
    waits = np.diff(tried)
    assert waits[0] == 1
    # Doubled each time, up to a few seconds of video.
    assert (waits[1:] == np.minimum(2 * waits[:-1], 8 * settings.new_after_frames)).all()
    # A promise that grows ends the wait at once, and the next one is short again.
    more = pair(0, frame + 1, parallax_px=10.1 * settings.retry_gain)
    assert manager.worth_trying([more]) is more
    manager.failed(more)
    assert manager.worth_trying([replace(more, current=more.current + settings.new_after_frames)]) is not None


def test_after_a_map_that_was_refused_all_pairs_rest_unless_one_promises_more():
    """A map takes the time of some frames: a window of references would fall behind the video."""
    settings = CONFIG.keyframes
    manager = KeyframeManager(CAMERA, CONFIG)
    manager.failed(pair(0, 20, parallax_px=10), as_map=True)
    other = pair(5, 21, parallax_px=10)
    assert manager.worth_trying([other]) is None
    assert manager.worth_trying([replace(other, parallax_px=10.1 * settings.retry_gain)]) is not None
    later = replace(other, current=23)
    assert manager.worth_trying([later]) is later
    without_map = KeyframeManager(CAMERA, CONFIG)
    without_map.failed(pair(0, 20, parallax_px=10))
    assert without_map.worth_trying([other]) is other
