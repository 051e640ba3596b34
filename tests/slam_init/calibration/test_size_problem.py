"""Images of another size than their calibration: the message names the cause that the sizes tell."""

import numpy as np
import pytest
from make_files import picture, write, write_image
from PIL import Image

from slam_init.calibration.files import load_camera
from slam_init.datasets import open_source
from slam_init.errors import CalibrationError, SourceError

CALIBRATION = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"


@pytest.mark.parametrize(
    ("size", "orientation", "words"),
    [
        ((48, 64), 6, "EXIF orientation.*turned by 90 degrees clockwise"),
        ((48, 64), 8, "EXIF orientation.*turned by 90 degrees anticlockwise"),
        ((48, 64), 1, "turned by 90 degrees: turn the images"),
        ((128, 48), 1, "two pictures side by side"),
        ((64, 96), 1, "two pictures one above the other"),
        ((32, 24), 1, "scale fx, fy, cx, cy"),
    ],
)
def test_the_turn_and_two_pictures_in_one_are_named(tmp_path, size, orientation, words):
    """By a calibration in the folder, one that is read for the images, and one that is given with its own size."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    for name in ("a.jpg", "b.jpg"):
        Image.new("L", size).save(tmp_path / name, exif=exif)
    source = open_source(tmp_path)
    assert any("EXIF" in note for note in source.notes) == (orientation != 1)
    calibration = write(tmp_path / "camera.yaml", CALIBRATION)
    with pytest.raises(CalibrationError, match=f"64x48.*{size[0]}x{size[1]}.*{words}"):
        open_source(tmp_path)
    with pytest.raises(CalibrationError, match=words):
        load_camera(calibration, size, orientation)
    write_image(tmp_path / "c.jpg", np.zeros((48, 64), np.uint8))
    for name in ("a.jpg", "b.jpg"):
        (tmp_path / name).rename(tmp_path / f"z{name}")
    with pytest.raises(SourceError, match=words if "scale" not in words else "all sizes must be equal"):
        list(open_source(tmp_path).frames())


def test_an_upright_image_of_the_right_size_has_no_note(tmp_path):
    write_image(tmp_path / "a.jpg", picture())
    write(tmp_path / "camera.yaml", CALIBRATION)
    assert not any("EXIF" in note for note in open_source(tmp_path).notes)
