"""Images of 16 bits: the texture is kept wherever it lies in the range, for all images of a sequence alike."""

from itertools import pairwise

import cv2
import numpy as np
from make_files import write, write_image

from slam_init.datasets import open_source
from slam_init.datasets.image_files import GreyLevels

RAMP = np.linspace(0.0, 1.0, 48 * 64).reshape(48, 64)


def test_two_thirds_of_the_levels_are_kept_wherever_the_range_lies():
    for low, span in ((0, 4095), (7300, 820), (0, 65535), (64000, 1500), (40, 60), (100, 255), (30000, 3)):
        image = np.round(low + span * RAMP).astype(np.uint16)
        image[0, 0], image[-1, -1] = 0, 65535  # a dead pixel and a hot one
        reduced = GreyLevels.of([image]).reduced(image)
        order = np.argsort(image, axis=None, kind="stable")
        assert reduced.dtype == np.uint8 and (np.diff(reduced.ravel()[order].astype(int)) >= 0).all()
        assert len(np.unique(reduced)) >= 0.6 * min(span, 255)
        # A step of one level of the image is never more than one level.
        steps = np.diff(np.unique(GreyLevels.of([image]).reduced(np.arange(low, low + span, dtype=np.uint16))))
        assert not len(steps) or steps.max() <= 1


def test_images_outside_of_the_range_become_black_and_white_and_8_bits_stay():
    levels = GreyLevels.of([np.round(7300 + 800 * RAMP).astype(np.uint16)])
    assert levels.reduced(np.array([[0, 5000, 60000, 65535]], np.uint16)).tolist() == [[0, 0, 255, 255]]
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert levels.reduced(grey) is grey
    assert GreyLevels.of([grey]) == GreyLevels.of([np.zeros((4, 4), np.uint16)]) == GreyLevels()


def test_all_images_of_a_folder_have_one_range_and_a_note_states_it(tmp_path):
    """The scene becomes warmer. Wherever a run begins, in a plain folder or a list, an image is the same."""
    for k in range(20):
        write_image(tmp_path / "images" / f"{k}.png", np.round(7000 + 30 * k + 800 * RAMP).astype(np.uint16))
    plain = open_source(tmp_path)
    frames = [frame.image for frame in plain.frames()]
    assert sum("16 bits" in note for note in plain.notes) == 1
    assert all(np.mean(before) < np.mean(after) for before, after in pairwise(frames))
    assert all(len(np.unique(image)) > 80 and image.max() < 255 for image in frames)
    write(tmp_path / "rgb.txt", "".join(f"{k / 30} images/{k}.png\n" for k in range(20)))
    for source in (plain, open_source(tmp_path)):
        np.testing.assert_array_equal(next(source.frames(13)).image, frames[13])
    write_image(tmp_path / "grey" / "a.png", cv2.imread(str(tmp_path / "images" / "0.png")))
    grey = open_source(tmp_path / "grey")
    assert next(grey.frames()).image.dtype == np.uint8 and not any("16 bits" in note for note in grey.notes)
