"""Static overlays and black borders are found where the image moves, and nothing is found in clean sequences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from make_scene import SMALL_CAMERA as CAMERA
from make_scene import SMALL_SIZE as SIZE
from make_scene import texture, window

from slam_init.config import TrackingConfig
from slam_init.frontend.picture_check import PictureCheck
from slam_init.frontend.tracks import Tracker
from slam_init.types.frame import Observations

TEXTURE = texture(1, 320, 520)


def notes_of(images):
    tracker, overlay = Tracker(CAMERA, TrackingConfig(max_tracks=300)), PictureCheck()
    for frame in images:
        overlay.observe(frame, tracker.track(frame))
    return tuple(note for note in overlay.notes if "--mask" in note)


def moving(change=lambda image: image, step_px=4.0, count=20):
    for k in range(count):
        frame = window(TEXTURE, 100 + step_px * k, 60 + 0.3 * k, *SIZE, index=k)
        yield replace(frame, image=change(frame.image.copy()))


def stamped(image):
    cv2.rectangle(image, (10, 15), (250, 50), 0, -1)
    return cv2.putText(image, "12:00:00 CAM 1", (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)


def behind_a_round_lens(image):
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    image[np.hypot(x - SIZE[0] / 2, y - SIZE[1] / 2) > 0.5 * SIZE[0]] = 5
    return image


def test_a_time_stamp_is_found_with_its_place():
    (note,) = notes_of(moving(stamped))
    left, right, top, bottom = (
        int(word.strip(",")) for word in note.replace("(", " ").split() if word.strip(",").isdigit()
    )
    assert "static overlay" in note and "--mask" in note
    assert 10 <= left < right <= 240 and 10 <= top < bottom <= 50


def test_a_round_lens_is_found():
    (note,) = notes_of(moving(behind_a_round_lens))
    assert "black in all frames" in note and "--mask" in note


def test_the_mask_ends_the_advice():
    mask = behind_a_round_lens(np.full(SIZE[::-1], 255, np.uint8))
    mask = np.where(mask > 5, np.uint8(255), np.uint8(0))
    assert notes_of(replace(frame, mask=mask) for frame in moving(behind_a_round_lens)) == ()


@pytest.mark.parametrize("change", [stamped, behind_a_round_lens])
def test_a_static_camera_shows_no_overlay(change):
    assert notes_of(moving(change, step_px=0.0)) == ()


def test_a_clean_sequence_and_a_dark_one_have_no_advice():
    assert notes_of(moving()) == ()
    assert notes_of(moving(lambda image: image // 20)) == ()


@pytest.mark.parametrize("field", ["forward", "roll", "far away"])
def test_flow_that_vanishes_somewhere_is_no_overlay(field):
    """The focus of expansion, the axis of a roll, and a row of zero flow (a plane that ends at the horizon)."""
    start = np.random.default_rng(0).uniform((0, 0), SIZE, (800, 2))
    centre = np.array(SIZE) / 2
    overlay = PictureCheck()
    for k in range(30):
        offset = start - centre
        if field == "forward":
            pixels = centre + offset * 1.02**k
        elif field == "roll":
            turned = np.stack([-offset[:, 1], offset[:, 0]], axis=1)
            pixels = centre + offset * np.cos(0.03 * k) + turned * np.sin(0.03 * k)
        else:
            pixels = start + np.stack([0.03 * k * np.abs(offset[:, 1]), 0 * start[:, 0]], axis=1)
        pixels = pixels + np.random.default_rng(k).normal(0, 0.05, pixels.shape)
        frame = window(TEXTURE, 100, 60, *SIZE, index=k)
        ids = np.arange(len(pixels))
        overlay.observe(frame, Observations(k, k / 30, "", ids, pixels, np.zeros((len(ids), 3))))
    assert overlay.notes == ()
