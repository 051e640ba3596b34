"""What is wrong with images as pictures is reported, and nothing of ordinary ones."""

import cv2
import numpy as np

from slam_init.frontend.picture_check import PictureCheck
from slam_init.types.frame import Frame, Observations

NO_TRACKS = Observations(0, 0.0, "", np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)))


def texture(seed):
    noise = np.random.default_rng(seed).integers(0, 256, (240, 480), np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)


def notes_on(images):
    check = PictureCheck()
    for image in images:
        check.observe(Frame(0, 0.0, "", image), NO_TRACKS)
    return check.notes


def test_each_finding_is_reported_alone():
    ordinary = [texture(seed) for seed in range(6)]
    black = np.zeros((240, 480), np.uint8)
    # The right camera sees all a little to the left, and a near box farther.
    stereo = [np.hstack([one[:, 20:260], one[:, 26:266]]) for one in ordinary]
    for one in stereo:
        one[80:160, 60:140], one[80:160, 280:360] = 40, 40
    cases = [
        (ordinary, None),
        ([texture(0)] * 6, None),
        ([black] * 6, "6 of 6 images are empty"),
        ([*ordinary, black, black], "2 of 8 images are empty"),
        ([100 + one // 85 for one in ordinary], "grey levels only"),
        ([(one > 128).astype(np.uint8) * 255 for one in ordinary], "use 2 grey levels only"),
        (stereo, "two pictures side by side"),
        ([np.ascontiguousarray(one.T) for one in stereo], "two pictures one above the other"),
    ]
    for images, expected in cases:
        found = notes_on(images)
        assert len(found) == (expected is not None) and (expected is None or expected in found[0])
