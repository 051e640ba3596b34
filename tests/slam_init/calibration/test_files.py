"""Calibration files: paths, sizes; broken, unsafe and impossible files are refused in one line. Single numbers."""

import math

import numpy as np
import pytest
from calibration_texts import assert_refused, own
from make_files import write
from path_types import PATH_TYPES

from slam_init.calibration.files import load_camera, load_yaml, prior_camera
from slam_init.errors import CalibrationError


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_the_readers_of_calibrations_take_every_type_of_path(tmp_path, path_type):
    path = path_type(write(tmp_path / "camera.yaml", own(fx=520)))
    assert load_camera(path).fx == 520
    assert load_yaml(path)["fx"] == 520


BILLION_LAUGHS = "a: &a [x, x]\nb: &b [*a, *a]\nfx: *b\n"
BROKEN = {
    "a list": ("- 1\n- 2\n", "key: value"),
    "a word": ("hello", "key: value"),
    "broken yaml": ("fx: [1, 2\nfy: }", "broken YAML"),
    "tab": ("fx:\t\t1\n\tfy: 2", "YAML"),
    "a list that is called a mapping": ("fx: !!opencv-matrix [a, b]\n", "refused YAML"),
    "mappings that are called pairs": ("fx: !!map\n  - {a: 1}\n", "refused YAML"),
    "aliases": (BILLION_LAUGHS, "aliases"),
    "deep": ("[" * 5000, "YAML"),
    "empty": ("", "empty"),
    "blank": ("\n  \n", "empty"),
    "binary": (bytes(range(256)), "text"),
    "zeros": (b"\0" * 100, "text"),
    "huge": (b"a: 1\n" * 300_000, "kB"),
}


def test_a_broken_file_is_refused_in_one_line_that_names_it(tmp_path):
    for text, word in BROKEN.values():
        assert_refused(write(tmp_path / "bad camera é.yaml", text), word)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "nothing.yaml", tmp_path, "a\0b"):
        with pytest.raises(CalibrationError):
            load_camera(path)


IMPOSSIBLE = {
    "focal length in another unit": ("fx: 520", "fx: 0.8", "fx"),
    "focal length that overflows": ("fx: 520", "fx: 1e300", "fx"),
    "principal point that is far away": ("cy: 240", "cy: 1e9", "cy"),
    "slip in the decimal point": ("fx: 520", "fx: 5200", "too different"),
    "a key given twice": ("fx: 520", "fx: 520\nfx: 500", "fx is given twice"),
    "distortion that reaches a spot": ("distortion: []", "distortion: [-50, 0, 0, 0]", "% of the image"),
    "distortion that overflows": ("distortion: []", "distortion: [1.0e+200, 0, 0, 0]", "larger than those of lenses"),
}


def test_an_impossible_calibration_is_refused_in_one_line(tmp_path):
    good = "width: 640\nheight: 480\nfx: 520\nfy: 520\ncx: 320\ncy: 240\ndistortion: []\n"
    assert load_camera(write(tmp_path / "good.yaml", good)).fx == 520
    for old, new, word in IMPOSSIBLE.values():
        assert_refused(write(tmp_path / "bad.yaml", good.replace(old, new)), word)


def test_unsafe_yaml_executes_nothing(tmp_path):
    victim = tmp_path / "victim"
    assert_refused(write(tmp_path / "c.yaml", f"fx: !!python/object/apply:os.mkdir ['{victim}']\n"), "refused YAML")
    assert not victim.exists()


# -- one number, or none ---------------------------------------------------------------------------


SIZE = (640, 480)


def test_of_an_unknown_camera_the_size_is_known_and_the_focal_length_within_a_factor_of_four():
    camera = prior_camera(SIZE)
    assert (camera.width, camera.height, camera.cx, camera.cy, camera.source) == (*SIZE, 319.5, 239.5, "prior")
    # Two standard deviations hold 40 to 95 degrees across.
    for fov_deg in (40, 60, 80, 95):
        focal_px = 320 / math.tan(math.radians(fov_deg / 2))
        assert abs(math.log(focal_px / camera.fx)) < 2 * camera.focal_sigma


def test_a_number_is_a_focal_length_or_a_field_of_view_across_the_longer_side():
    by_focal = load_camera("f=700", SIZE)
    assert (by_focal.fx, by_focal.fy, by_focal.source) == (700, 700, "stated")
    assert by_focal.focal_sigma < prior_camera(SIZE).focal_sigma
    by_field = load_camera("fov=90", SIZE)
    np.testing.assert_allclose(by_field.fx, 320)
    assert load_camera("fov=90", SIZE[::-1]).fx == by_field.fx


@pytest.mark.parametrize("text", ["f=", "f=x", "f=nan", "f=-5", "f=0.1", "fov=0", "fov=180", "fov=inf", "fov=wide"])
def test_a_number_of_no_camera_is_refused_in_one_line(text):
    with pytest.raises(CalibrationError, match=r"focal|degrees"):
        load_camera(text, SIZE)


@pytest.mark.parametrize("text", ["auto", "f=700", "fov=90"])
def test_without_images_there_is_no_size(text):
    with pytest.raises(CalibrationError, match="size"):
        load_camera(text)
