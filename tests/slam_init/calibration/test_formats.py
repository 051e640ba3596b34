"""Every calibration format gives the same camera; missing and impossible values are refused in one line."""

import pytest
from calibration_texts import FORMATS, ORB2, OWN, RADTAN_COEFFICIENTS, ROS, SIZE, own
from make_files import write

from slam_init.calibration.files import load_camera
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("form", ["as is", "BOM and CRLF"])
def test_every_format_gives_the_same_camera(tmp_path, name, form):
    text, expected = FORMATS[name]
    data = text.encode() if form == "as is" else b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()
    assert load_camera(write(tmp_path / name, data), SIZE) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("1 SIMPLE_PINHOLE 640 480 500 320 240", Camera("pinhole", 640, 480, 500, 500, 319.5, 239.5)),
        ("1 PINHOLE 640 480 500 510 320 240", Camera("pinhole", 640, 480, 500, 510, 319.5, 239.5)),
        ("3 SIMPLE_RADIAL 640 480 500 320 240 -0.1", ("radtan", (-0.1, 0, 0, 0))),
        ("1 RADIAL 640 480 500 320 240 -0.1 0.02", ("radtan", (-0.1, 0.02, 0, 0))),
    ],
)
def test_every_camera_model_of_colmap_is_read(tmp_path, line, expected):
    camera = load_camera(write(tmp_path / "cameras.txt", line))
    if isinstance(expected, tuple):
        model, distortion = expected
        expected = Camera(model, 640, 480, 500, 500, 319.5, 239.5, distortion)
    assert camera == expected


def test_a_camera_without_distortion_is_a_pinhole_under_every_model_name(tmp_path):
    for model, distortion in (("none", "[]"), ("radtan", "[0, 0, 0, 0]"), ("pinhole", "[]")):
        camera = load_camera(write(tmp_path / "c.yaml", OWN.format(model=model, distortion=distortion)))
        assert (camera.model, camera.distortion) == ("pinhole", ())


def test_a_file_without_a_size_takes_that_of_the_images(tmp_path):
    path = write(tmp_path / "orb.yaml", ORB2)
    assert load_camera(path, (100, 90)).width == 100
    with pytest.raises(CalibrationError, match="width"):
        load_camera(path)


KALIBR = "cam0: {camera_model: pinhole, intrinsics: [500, 510, 320, 240], resolution: [640, 480], line_delay: %s}\n"


@pytest.mark.parametrize(
    ("text", "readout_ms", "direction"),
    [
        (own() + "readout_ms: 25\n", 25.0, "down"),
        (own() + "readout_ms: 25\nreadout_direction: left\n", 25.0, "left"),
        (own() + "readout_ms: 0\n", 0.0, "down"),
        (own(), None, "down"),
        (KALIBR % "5.0e-5", 24.0, "down"),  # 50 microseconds for each of 480 rows
        (KALIBR % "-5.0e-5", 24.0, "up"),
    ],
)
def test_the_readout_of_a_rolling_shutter_is_read(tmp_path, text, readout_ms, direction):
    camera = load_camera(write(tmp_path / "c.yaml", text))
    assert camera.readout_ms == (None if readout_ms is None else pytest.approx(readout_ms))
    assert camera.readout_direction == direction


BROKEN = {
    "negative readout": (own() + "readout_ms: -5\n", "readout"),
    "readout in seconds": (own() + "readout_ms: 30 ms\n", "readout_ms"),
    "readout sideways": (own() + "readout_ms: 5\nreadout_direction: sideways\n", "readout direction"),
    "zero focal": (own(fx=0), "fx"),
    "negative focal": (own(fy=-480), "fy"),
    "nan focal": (own(fx=".nan"), "fx"),
    "infinite focal": (own(fx=".inf"), "fx"),
    "text focal": (own(fx="wide"), "fx"),
    "boolean focal": (own(fx="yes"), "fx"),
    "list focal": (own(fx="[1, 2]"), "fx"),
    "missing focal": (own(fx=None), "fx"),
    "null focal": (own(fx="null"), "fx"),
    "huge focal": (own(fx="1" + "0" * 400), "fx"),
    "zero width": (own(width=0), "size"),
    "half a pixel": (own(width=640.5), "whole"),
    "unknown model": (own(distortion_model="omni"), "distortion_model"),
    "six coefficients": (own(distortion="[1, 2, 3, 4, 5, 6]", distortion_model="radtan"), "rational"),
    "text coefficient": (own(distortion="[0.1, x, 0, 0]"), "distortion"),
    "scalar distortion": (own(distortion="0.1", distortion_model="radtan"), "distortion"),
    "fisheye with two": (own(distortion="[0.1, 0]", distortion_model="fisheye"), "fisheye"),
    "other keys": ("name: camera\n", "no known calibration"),
    "short matrix": ("K: [1, 2, 3]\nwidth: 640\nheight: 480\n", "K"),
    "skewed matrix": ("K: [500, 1, 320, 0, 500, 240, 0, 0, 1]\nwidth: 640\nheight: 480\n", "skew"),
    "kalibr without": ("cam0: 3\n", "cam0"),
    "kalibr omni": ("cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4, 5]}\n", "camera_model"),
    "kalibr three": ("cam0: {intrinsics: [1, 2, 3], resolution: [640, 480]}\n", "intrinsics"),
    "orb unknown": ("Camera.type: Rolling\nCamera.fx: 1\n", "Camera.type"),
    "orb missing": ("Camera.fx: 500\n", "Camera.fy"),
    "rational": (
        ROS.format(model="rational_polynomial", distortion=RADTAN_COEFFICIENTS + ", 0, 0.1, 0, 0"),
        "rational",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_missing_or_impossible_value_is_refused_in_one_line_that_names_file_and_key(tmp_path, case):
    text, word = BROKEN[case]
    path = write(tmp_path / "bad camera é.yaml", text)
    with pytest.raises(CalibrationError, match=word) as caught:
        load_camera(path, (640, 480))
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("cameras.txt", "", "empty"),
        ("cameras.txt", "# only a comment\n", "0 cameras"),
        ("cameras.txt", "1 PINHOLE 640 480 1 1 1 1\n2 PINHOLE 640 480 1 1 1 1\n", "2 cameras"),
        ("cameras.txt", "1 FOV 640 480 1 1 1 1 1\n", "PINHOLE"),
        ("cameras.txt", "1 PINHOLE 640 480 1 1 1\n", "4 parameters"),
        ("cameras.txt", "1 PINHOLE 640 480 x 1 1 1\n", "fx"),
        ("cameras.txt", "1 FULL_OPENCV 640 480 500 500 320 240 0 0 0 0 0 0.1 0 0\n", "rational"),
        ("camera.xml", "<opencv_storage><a>", "XML"),
        ("camera.xml", "<html></html>", "calibration|XML"),
    ],
)
def test_broken_colmap_and_xml_files_are_refused_in_one_line(tmp_path, name, text, word):
    with pytest.raises(CalibrationError, match=word) as caught:
        load_camera(write(tmp_path / name, text), (640, 480))
    assert len(str(caught.value).splitlines()) == 1
