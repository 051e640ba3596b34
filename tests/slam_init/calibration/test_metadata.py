"""Focal lengths from EXIF and from the tags of videos; the cause of an unexpected size."""

import math

import numpy as np
import pytest
from make_files import picture, write, write_image
from make_video import corner_frames, write_by_pyav
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from slam_init.calibration.files import camera_of_source, load_camera
from slam_init.calibration.metadata import focal_from_metadata
from slam_init.datasets import open_source
from slam_init.errors import CalibrationError, SourceError

SIZE = (64, 48)
MAKE, MODEL, EXIF = 0x010F, 0x0110, 0x8769
FOCAL_MM, WIDTH, HEIGHT, PLANE_X, PLANE_UNIT, ZOOM, FILM_MM = 0x920A, 0xA002, 0xA003, 0xA20E, 0xA210, 0xA404, 0xA405
APPLE = "com.apple.quicktime.camera.focal_length.35mm_equivalent"


def photograph(path, tags=None, maker="Apple", model="iPhone 13", size=SIZE):
    """A photograph with EXIF."""
    exif = Image.Exif()
    exif[MAKE], exif[MODEL] = maker, model
    exif.get_ifd(EXIF).update(tags or {})
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("L", size).save(path, exif=exif)
    return path


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_a_35_mm_equivalent_lies_between_diagonal_and_width(tmp_path, suffix):
    found = focal_from_metadata([photograph(tmp_path / f"p{suffix}", {FILM_MM: 26})], SIZE)
    by_width, by_diagonal = 26 * 64 / 36, 26 * 80 / math.hypot(36, 24)
    assert by_width < found.focal_px < by_diagonal
    assert (by_diagonal - by_width) / 2 < found.sigma_px < 0.05 * found.focal_px


def test_a_turned_or_resized_photograph_has_the_focal_length_of_its_pixels(tmp_path):
    tags = {FILM_MM: 28, WIDTH: 640, HEIGHT: 480, FOCAL_MM: 5.0, PLANE_X: 1000.0, PLANE_UNIT: 3}
    path = photograph(tmp_path / "p.jpg", tags)
    found = focal_from_metadata([path], (640, 480))
    assert focal_from_metadata([path], (480, 640)) == found
    assert focal_from_metadata([path], (320, 240)).focal_px == pytest.approx(found.focal_px / 2)
    assert focal_from_metadata([path], (640, 360)) is None, "cut to another format"


@pytest.mark.parametrize(("unit", "per_mm"), [(2, 1 / 25.4), (3, 0.1), (4, 1.0)])
def test_the_resolution_of_the_focal_plane(tmp_path, unit, per_mm):
    tags = {FOCAL_MM: 50.0, PLANE_X: 1.5 / per_mm, PLANE_UNIT: unit, WIDTH: 64, HEIGHT: 48}
    found = focal_from_metadata([photograph(tmp_path / "p.jpg", tags)], SIZE)
    assert found.focal_px == pytest.approx(75, rel=1e-3) and 0.02 < found.sigma_px / found.focal_px < 0.05
    zoomed = focal_from_metadata([photograph(tmp_path / "z.jpg", tags | {ZOOM: 2.0})], SIZE)
    assert zoomed.focal_px == pytest.approx(2 * found.focal_px)


def test_statements_that_contradict_each_other_are_unsure(tmp_path):
    tags = {FILM_MM: 26, FOCAL_MM: 5.1, PLANE_X: 900.0, PLANE_UNIT: 3, WIDTH: 64, HEIGHT: 48}
    found = focal_from_metadata([photograph(tmp_path / "p.jpg", tags)], SIZE)
    alone = focal_from_metadata([photograph(tmp_path / "q.jpg", {FILM_MM: 26})], SIZE)
    assert found.sigma_px >= abs(found.focal_px - alone.focal_px) > 0
    agreeing = tags | {PLANE_X: 10 * alone.focal_px / 5.1}
    sure = focal_from_metadata([photograph(tmp_path / "r.jpg", agreeing)], SIZE)
    assert sure.sigma_px < alone.sigma_px


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {FILM_MM: 0},
        {FILM_MM: 60000},
        {FOCAL_MM: 5.0},
        {FOCAL_MM: IFDRational(5, 0), PLANE_X: 900.0, WIDTH: 64, HEIGHT: 48},
        {FOCAL_MM: 5.0, PLANE_X: 900.0, PLANE_UNIT: 9, WIDTH: 64, HEIGHT: 48},
    ],
)
def test_impossible_tags_determine_nothing(tmp_path, tags):
    assert focal_from_metadata([photograph(tmp_path / "p.jpg", tags, model="\0\nx")], SIZE) is None


def test_a_folder_determines_a_focal_length_if_nobody_zoomed(tmp_path):
    for i in range(3):
        photograph(tmp_path / "same" / "images" / f"{i}.jpg", {FILM_MM: 26})
        photograph(tmp_path / "zoom" / f"{i}.jpg", {FILM_MM: 26 + i})
    write_image(tmp_path / "bare" / "0.png", picture())
    assert camera_of_source(open_source(tmp_path / "same")).source == "metadata"
    for name in ("zoom", "bare"):
        assert camera_of_source(open_source(tmp_path / name)).source == "prior"


def test_a_video_determines_the_focal_length_of_its_photographs_which_is_less_sure(tmp_path):
    tags = {APPLE: "26", "com.apple.quicktime.make": "Apple", "com.apple.quicktime.model": "iPhone 13"}
    path = write_by_pyav(tmp_path / "v.mp4", corner_frames(3), tags=tags)
    found = focal_from_metadata([path], (1920, 1080))
    uncropped_px = 26 * 1920 / 36
    assert uncropped_px < found.focal_px < 1.25 * 1.05 * uncropped_px
    assert 0.06 < found.sigma_px / found.focal_px < 0.1
    assert focal_from_metadata([path], (1080, 1920)) == found


def test_broken_files_determine_nothing_and_missing_ones_are_errors(tmp_path):
    whole = photograph(tmp_path / "p.jpg", {FILM_MM: 26}).read_bytes()
    for length in range(0, len(whole), 7):
        focal_from_metadata([write(tmp_path / "cut.jpg", whole[:length])], SIZE)
    assert focal_from_metadata([write(tmp_path / "t.mp4", "a text")], SIZE) is None
    with pytest.raises(SourceError, match="nowhere"):
        focal_from_metadata([tmp_path / "nowhere.jpg"], SIZE)


# -- images of another size ------------------------------------------------------------------------


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
