"""Images whose names state no times: a video where the steps are small and even, else photographs."""

import cv2
import numpy as np
import pytest
from make_files import picture, write_image
from paths import DATA
from PIL import Image

from slam_init import run
from slam_init.calibration.files import load_camera
from slam_init.datasets import open_source

TEXTURE = cv2.GaussianBlur(picture(0, (1200, 300), 1), (0, 0), 3)
STREET = DATA / "phone" / "lund_street"


def views(lefts):
    """What a camera of 320 x 240 pixels sees of a wall, with its left side at these columns."""
    return [np.ascontiguousarray(TEXTURE[20:260, left : left + 320]) for left in lefts]


@pytest.mark.parametrize(
    ("lefts", "rate_hz"),
    [
        (range(0, 160, 8), 30),  # even and small
        ([0] * 8, 30),  # a static camera
        (np.cumsum([0, 4, 5, 7, 8, 8, 7, 5, 3]), 30),  # a hand that swings
        (range(0, 800, 80), 1),  # a panorama: even and large
        (np.cumsum([0, 5, 40, 12, 60, 3, 33, 20, 70]), 1),
        ([0, 40, 45], 1),
        ([0, 8], 1),  # no step follows another one
        ([0], 1),
    ],
)
def test_the_steps_distinguish_a_video_from_photographs(tmp_path, lefts, rate_hz):
    for k, view in enumerate(views(lefts)):
        write_image(tmp_path / f"{k}.png", view)
    source = open_source(tmp_path)
    np.testing.assert_allclose(source.timestamps_s, np.arange(len(lefts)) / rate_hz)
    (note,) = source.notes
    assert ("as a video of 30 frames a second" if rate_hz == 30 else "as photographs") in note


def test_images_that_name_their_camera_are_photographs(tmp_path):
    exif = Image.Exif()
    exif[0x0110] = "phone"
    for k, view in enumerate(views(range(0, 80, 8))):
        Image.fromarray(view).save(tmp_path / f"{k}.jpg", exif=exif)
    assert open_source(tmp_path).timestamps_s[1] == 1


@pytest.mark.skipif(not STREET.is_dir(), reason="no real sequences: set SLAM_INIT_DATA to their folder")
def test_three_photographs_of_a_street_in_a_plain_folder_have_a_map(tmp_path):
    for path in sorted((STREET / "images").iterdir())[:3]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    result, _ = run(open_source(tmp_path), load_camera(STREET / "camera.yaml"), overview=False)
    assert result.map is not None and result.frames_to_init <= 3
