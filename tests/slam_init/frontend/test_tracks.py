"""Tracks on textures whose motion is known, by flow and by descriptors; ids, limits and history of the tracks."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from make_scene import SMALL_CAMERA as CAMERA
from make_scene import SMALL_SIZE as SIZE
from make_scene import texture, window

from slam_init.config import TrackingConfig
from slam_init.frontend import flow as flow_module
from slam_init.frontend.tracks import Tracker
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History, common_tracks

CONFIG = TrackingConfig()
TEXTURE = texture(1, 500, 900)


def frames_from(*places):
    """Frames that look at the texture from these places."""
    return [window(TEXTURE, x, y, *SIZE, index=k) for k, (x, y) in enumerate(places)]


def follow(frames, camera=CAMERA, config=CONFIG):
    tracker = Tracker(camera, config)
    return tracker, [tracker.track(frame) for frame in frames]


def displacement(a, b):
    i, j = common_tracks(a, b)
    return b.pixels[j] - a.pixels[i]


def observed(frame, ids):
    ids = np.asarray(ids, np.int64)
    zeros = np.zeros((len(ids), 2))
    return Observations(frame, float(frame), "", ids, zeros, np.zeros((len(ids), 3)))


def test_a_known_shift_is_measured_to_a_tenth_of_a_pixel():
    _, seen = follow(frames_from(*[(100 + 4.3 * k, 60 + 1.7 * k) for k in range(6)]))
    moved = displacement(seen[0], seen[-1])
    assert len(moved) > 0.5 * len(seen[0])
    errors = np.linalg.norm(moved - (-21.5, -8.5), axis=1)
    assert np.median(errors) < 0.1
    assert np.percentile(errors, 95) < 0.7


def test_ids_are_sorted_and_unique_and_bearings_fit_the_pixels():
    _, seen = follow(frames_from(*[(100 + 15 * k, 60) for k in range(8)]))
    for observations in seen:
        assert (np.diff(observations.track_ids) > 0).all()
        assert len(observations.pixels) == len(observations.bearings) == len(observations.colors) == len(observations)
        np.testing.assert_allclose(CAMERA.project(observations.bearings), observations.pixels, atol=1e-9)
        assert (observations.pixels >= -0.5).all()
        assert (observations.pixels <= np.array(SIZE) - 0.5).all()


def test_lost_tracks_are_replaced_by_tracks_with_new_ids():
    _, seen = follow(frames_from(*[(100 + 15 * k, 60) for k in range(12)]))
    assert len(seen[-1]) > 0.5 * len(seen[0])
    lost = np.setdiff1d(seen[0].track_ids, seen[5].track_ids)
    assert len(lost) > 0
    assert not np.isin(lost, seen[-1].track_ids).any()  # an id is not used again for another point


def test_new_features_have_the_configured_distance_from_each_other():
    _, (first, *_) = follow(frames_from((100, 60)))
    gaps = np.linalg.norm(first.pixels[:, None] - first.pixels[None], axis=2) + 1e9 * np.eye(len(first))
    assert gaps.min() >= CONFIG.min_distance * SIZE[0] - 1


def test_of_two_tracks_that_meet_in_one_place_the_older_is_kept():
    """The scene shrinks to a third, so that neighbouring tracks end within a pixel of one another."""
    frames = [
        Frame(k, k / 30, "", cv2.warpAffine(TEXTURE, np.array([[s, 0, 20], [0, s, 20]]), SIZE, flags=cv2.INTER_AREA))
        for k, s in enumerate(1.12 ** -np.arange(12.0))
    ]
    _, seen = follow(frames)
    last = seen[-1]
    cell = 0.5 * CONFIG.min_distance * SIZE[0]
    cells = np.floor(last.pixels / cell).astype(int)
    assert len(np.unique(cells, axis=0)) == len(cells)
    survivors = last.track_ids[last.track_ids < len(seen[0])]
    assert 0 < len(survivors) < len(seen[0])


def test_the_tracks_that_the_flow_kept_go_on_over_a_link_by_descriptors():
    """A part of the view jumps by half an image, the rest moves by a few pixels: the flow keeps the rest."""
    (first,), (near,), (far,) = frames_from((100, 60)), frames_from((106, 60)), frames_from((230, 60))
    image = far.image.copy()
    image[:, :140] = near.image[:, :140]
    tracker, (seen, linked) = follow([first, replace(far, index=1, image=image)])
    a, b = common_tracks(seen, linked)  # without the tracks that the link added to the first frame
    assert len(a) > 0.2 * len(seen)
    true = np.where(linked.pixels[b, :1] < 140, (-6, 0), (-130, 0))
    assert np.mean(np.linalg.norm(linked.pixels[b] - seen.pixels[a] - true, axis=1) < 1.0) > 0.95
    assert np.sum(true[:, 0] == -6) > 0.2 * len(seen)
    i, j = common_tracks(tracker.history[0], linked)
    jumped = linked.pixels[j] - tracker.history[0].pixels[i]
    assert np.sum(np.linalg.norm(jumped - (-130, 0), axis=1) < 1.0) >= 20
    assert (np.diff(linked.track_ids) > 0).all()


def test_matches_guide_the_flow_so_that_tracks_go_on_over_a_jump():
    """The flow alone loses all of them: the view moves by half an image at once."""
    _, (seen, jumped) = follow(frames_from((100, 60), (230, 60)))
    still_visible = seen.pixels[:, 0] > 140
    i, j = common_tracks(seen, jumped)
    assert len(i) > 0.4 * still_visible.sum()
    assert np.mean(np.linalg.norm(jumped.pixels[j] - seen.pixels[i] - (-130, 0), axis=1) < 1.0) > 0.95


@pytest.mark.parametrize(("keypoints", "by_descriptors"), [(600, True), (450, False)])
def test_a_flow_that_descriptors_contradict_gives_way_where_they_link_as_many(monkeypatch, keypoints, by_descriptors):
    """Of two photographs flow follows two fifths of the tracks to wrong places. Fewer matches contradict nothing."""
    flow = flow_module.flow

    def wrong(before, after, pixels, *rest, **options):
        found = flow(before, after, pixels, *rest, **options)
        kept = np.arange(len(pixels)) % 5 < 2
        return replace(found, kept=kept, pixels=pixels + np.array([9.0, 2.0]))

    frames = frames_from((100, 60), (160, 60))
    monkeypatch.setattr(flow_module, "flow", wrong)
    config = replace(CONFIG, sift_features=keypoints)
    tracker, (seen, linked) = follow(frames, config=config)
    moved = displacement(tracker.history[0], linked)
    right = np.linalg.norm(moved - (-60, 0), axis=1) < 1.0
    assert len(moved) > 30 and len(seen) > 100
    assert right.mean() > 0.95 if by_descriptors else not right.any()


def test_after_a_cut_to_another_scene_almost_no_tracks_are_left():
    other = window(texture(2, 500, 900), 100, 60, *SIZE, index=1)
    _, seen = follow([*frames_from((100, 60)), other])
    i, _ = common_tracks(*seen)
    assert len(i) < 0.1 * len(seen[0])


@pytest.mark.parametrize("level", [0, 255])
def test_an_empty_image_has_no_tracks_and_the_next_image_gets_new_ones(level):
    blank = Frame(1, 0.1, "", np.full((240, 320), level, np.uint8))
    first, last = frames_from((100, 60), (100, 60))
    _, seen = follow([blank, first, replace(blank, index=2), replace(last, index=3)])
    assert len(seen[0]) == 0
    assert len(seen[1]) > 100
    assert len(seen[2]) < 10
    assert len(seen[3]) > 100


def test_pixels_without_a_ray_are_not_tracked():
    """A fisheye lens whose polynomial stops growing inside of the image."""
    lens = Camera("fisheye", *SIZE, 90.0, 90.0, 159.5, 119.5, (-0.2, 0.0, 0.0, 0.0))
    assert np.isnan(lens.bearings(np.array([[1.0, 1.0]]))).any()
    _, seen = follow(frames_from((100, 60), (103, 60), (106, 60)), lens)
    for observations in seen:
        assert len(observations) > 20
        assert np.isfinite(observations.bearings).all()


def test_the_colours_of_tracks_are_rgb_values_of_the_image():
    grey = frames_from((100, 60))[0]
    tinted = np.stack([grey.image, grey.image, 255 - grey.image], axis=2)  # blue, green, red
    _, (seen,) = follow([Frame(0, 0.0, "", tinted)])
    x, y = np.round(seen.pixels).astype(int).T
    assert np.array_equal(seen.colors, tinted[y, x][:, ::-1])
    _, (plain,) = follow([grey])
    x, y = np.round(plain.pixels).astype(int).T
    assert np.array_equal(plain.colors, np.repeat(grey.image[y, x][:, None], 3, axis=1))


def test_the_history_is_bounded_and_keeps_the_requested_frames():
    history = History(CAMERA, 5)
    for frame in range(20):
        history.put(observed(frame, [frame]))
        history.forget(keep=[2])
        assert len(history) <= 6
    assert [o.frame for o in history] == [2, 15, 16, 17, 18, 19]
    history.put(observed(17, [1, 2, 3]))
    assert len(history[17]) == 3
    assert len(history) == 6


def test_what_was_measured_of_a_frame_goes_with_it():
    history = History(CAMERA, 5)
    for frame in range(8):
        history.put(observed(frame, [frame]))
        history.turned(frame, np.eye(3), 0.001)
    history.start_at(4)
    assert not set(range(4)) & set(history.relative_rotations)
    assert 7 in history.relative_rotations
