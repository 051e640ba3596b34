"""Laws of reduced and compressed images."""

import numpy as np

from slam_init.recording.images import bgr, reduced


def test_an_image_is_reduced_to_its_longer_side_and_never_enlarged():
    image = np.zeros((480, 640, 3), np.uint8)
    assert reduced(image, 640) is image
    assert reduced(image, 320).shape == (240, 320, 3)
    for size in ((640, 1), (1, 5000)):  # one row or column is kept
        assert min(reduced(np.zeros(size, np.uint8), 64).shape) == 1


def test_a_grey_image_gets_three_equal_channels_and_a_coloured_one_stays():
    grey = np.random.default_rng(0).integers(0, 255, (4, 5), np.uint8)
    assert (bgr(grey) == np.dstack([grey] * 3)).all()
    assert bgr(bgr(grey)) is not grey and bgr(bgr(grey)).shape == (4, 5, 3)
