"""Every format of a calibration gives the same camera; every broken one is refused in one line."""

import os

import numpy as np
import pytest

from slam_init.calibration.files import load_camera
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

SIZE = (752, 480)
RADTAN = Camera("radtan", *SIZE, 458.5, 457.25, 367.25, 248.5, (-0.28, 0.07, 0.0002, 1.76e-05))
FISHEYE = Camera("fisheye", *SIZE, 458.5, 457.25, 367.25, 248.5, (0.003, 0.0007, -0.002, 0.0002))

OWN = """model: pinhole
width: 752
height: 480
fx: 458.5
fy: 457.25
cx: 367.25
cy: 248.5
distortion_model: {model}
distortion: {distortion}
# order: k1, k2, p1, p2[, k3] (OpenCV)
"""
OPENCV = """%YAML:1.0
---
image_width: 752
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 458.5, 0., 367.25, 0., 457.25, 248.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.28, 0.07, 0.0002, 1.76e-05, 0. ]
"""
OPENCV_KD = """%YAML:1.0
K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 458.5, 0., 367.25, 0., 457.25, 248.5, 0., 0., 1. ]
D: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ -0.28, 0.07, 0.0002, 1.76e-05 ]
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>752</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>458.5 0. 367.25 0. 457.25 248.5 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>1</rows><cols>4</cols><dt>d</dt>
<data>-0.28 0.07 0.0002 1.76e-05</data></distortion_coefficients>
</opencv_storage>
"""
ORB2 = """%YAML:1.0

#--- Camera Parameters
Camera.fx: 458.5
Camera.fy: 457.25
Camera.cx: 367.25
Camera.cy: 248.5

Camera.k1: -0.28
Camera.k2: 0.07
Camera.p1: 0.0002
Camera.p2: 1.76e-05
Camera.fps: 20.0
Camera.RGB: 1
"""
ORB3_FISHEYE = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera1.fx: 458.5
Camera1.fy: 457.25
Camera1.cx: 367.25
Camera1.cy: 248.5
Camera1.k1: 0.003
Camera1.k2: 0.0007
Camera1.k3: -0.002
Camera1.k4: 0.0002
Camera.width: 752
Camera.height: 480
"""
KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [{distortion}]
  distortion_model: {model}
  intrinsics: [458.5, 457.25, 367.25, 248.5]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  intrinsics: [1, 1, 1, 1]
"""
EUROC = """# General sensor definitions.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.5, 457.25, 367.25, 248.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.76e-05]
"""
ROS = """image_width: 752
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [458.5, 0, 367.25, 0, 457.25, 248.5, 0, 0, 1]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: 5
  data: [{distortion}]
"""
ROS_TOPIC = """header: {seq: 0}
height: 480
width: 752
distortion_model: plumb_bob
D: [-0.28, 0.07, 0.0002, 1.76e-05, 0.0]
K: [458.5, 0.0, 367.25, 0.0, 457.25, 248.5, 0.0, 0.0, 1.0]
"""
R = "-0.28, 0.07, 0.0002, 1.76e-05"
F = "0.003, 0.0007, -0.002, 0.0002"

FORMATS = {
    "own.yaml": (OWN.format(model="radtan", distortion=f"[{R}]"), RADTAN),
    "own_fisheye.yaml": (OWN.format(model="fisheye", distortion=f"[{F}]"), FISHEYE),
    "own_equidistant.yaml": (OWN.format(model="equidistant", distortion=f"[{F}]"), FISHEYE),
    "opencv.yaml": (OPENCV, RADTAN),
    "opencv_kd.yml": (OPENCV_KD, RADTAN),
    "opencv.xml": (OPENCV_XML, RADTAN),
    "orb2.yaml": (ORB2, RADTAN),
    "orb3.yaml": (ORB3_FISHEYE, FISHEYE),
    "kalibr.yaml": (KALIBR.format(model="radtan", distortion=R), RADTAN),
    "kalibr_fisheye.yaml": (KALIBR.format(model="equidistant", distortion=F), FISHEYE),
    "sensor.yaml": (EUROC, RADTAN),
    "ros.yaml": (ROS.format(model="plumb_bob", distortion=R + ", 0"), RADTAN),
    "ros_rational.yaml": (ROS.format(model="rational_polynomial", distortion=R + ", 0, 0, 0, 0"), RADTAN),
    "ros_equidistant.yaml": (ROS.format(model="equidistant", distortion=F), FISHEYE),
    "camera_info.yaml": (ROS_TOPIC, RADTAN),
    "cameras.txt": (
        f"# Camera list\n1 OPENCV 752 480 458.5 457.25 367.75 249 {R.replace(',', '')}\n",
        RADTAN,
    ),
    "cameras_fisheye.txt": (
        f"1 OPENCV_FISHEYE 752 480 458.5 457.25 367.75 249 {F.replace(',', '')}",
        FISHEYE,
    ),
    "cameras_full.txt": (
        f"1 FULL_OPENCV 752 480 458.5 457.25 367.75 249 {R.replace(',', '')} 0 0 0 0\n",
        RADTAN,
    ),
}


def write(folder, name, text):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("form", ["as is", "BOM and CRLF"])
def test_every_format_gives_the_same_camera(tmp_path, name, form):
    text, expected = FORMATS[name]
    data = text.encode() if form == "as is" else b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()
    assert load_camera(write(tmp_path, name, data), SIZE) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("1 SIMPLE_PINHOLE 640 480 500 320 240", Camera("pinhole", 640, 480, 500, 500, 319.5, 239.5)),
        ("1 PINHOLE 640 480 500 510 320 240", Camera("pinhole", 640, 480, 500, 510, 319.5, 239.5)),
        ("3 SIMPLE_RADIAL 640 480 500 320 240 -0.1", ("radtan", (-0.1, 0, 0, 0))),
        ("1 RADIAL 640 480 500 320 240 -0.1 0.02", ("radtan", (-0.1, 0.02, 0, 0))),
    ],
)
def test_colmap_models(tmp_path, line, expected):
    camera = load_camera(write(tmp_path, "cameras.txt", line))
    if isinstance(expected, tuple):
        model, distortion = expected
        expected = Camera(model, 640, 480, 500, 500, 319.5, 239.5, distortion)
    assert camera == expected


def test_undistorted_in_any_words_is_a_pinhole(tmp_path):
    for model, distortion in (("none", "[]"), ("radtan", "[0, 0, 0, 0]"), ("pinhole", "[]")):
        camera = load_camera(write(tmp_path, "c.yaml", OWN.format(model=model, distortion=distortion)))
        assert (camera.model, camera.distortion) == ("pinhole", ())


def test_formats_without_a_size_take_that_of_the_images(tmp_path):
    path = write(tmp_path, "orb.yaml", ORB2)
    assert load_camera(path, (100, 90)).width == 100
    with pytest.raises(CalibrationError, match="width"):
        load_camera(path)


def test_a_calibration_of_other_images_is_refused_with_both_sizes(tmp_path):
    path = write(tmp_path, "c.yaml", OWN.format(model="none", distortion="[]"))
    with pytest.raises(CalibrationError, match=r"752x480.*376x240"):
        load_camera(path, (376, 240))


def test_guess_is_colmaps_prior_and_says_so():
    camera = load_camera("guess", (640, 480))
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.guessed) == (768, 768, 319.5, 239.5, True)
    np.testing.assert_array_equal(camera.K[2], [0, 0, 1])
    with pytest.raises(CalibrationError, match="size"):
        load_camera("guess")


def own(**changes):
    values = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240} | changes
    return "".join(f"{key}: {value}\n" for key, value in values.items() if value is not None)


BILLION_LAUGHS = "a: &a [x, x]\nb: &b [*a, *a]\nfx: *b\n"
BROKEN = {
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
    "a list": ("- 1\n- 2\n", "key: value"),
    "a word": ("hello", "key: value"),
    "other keys": ("name: camera\n", "no known calibration"),
    "broken yaml": ("fx: [1, 2\nfy: }", "broken YAML"),
    "tab": ("fx:\t\t1\n\tfy: 2", "YAML"),
    "unsafe yaml": ("fx: !!python/object/apply:os.system ['true']\n", "refused YAML"),
    "aliases": (BILLION_LAUGHS, "aliases"),
    "deep": ("[" * 5000, "YAML"),
    "empty": ("", "empty"),
    "blank": ("\n  \n", "empty"),
    "binary": (bytes(range(256)), "text"),
    "zeros": (b"\0" * 100, "text"),
    "huge": (b"a: 1\n" * 300_000, "kB"),
    "short matrix": ("K: [1, 2, 3]\nwidth: 640\nheight: 480\n", "K"),
    "skewed matrix": ("K: [500, 1, 320, 0, 500, 240, 0, 0, 1]\nwidth: 640\nheight: 480\n", "skew"),
    "kalibr without": ("cam0: 3\n", "cam0"),
    "kalibr omni": ("cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4, 5]}\n", "camera_model"),
    "kalibr three": ("cam0: {intrinsics: [1, 2, 3], resolution: [640, 480]}\n", "intrinsics"),
    "orb unknown": ("Camera.type: Rolling\nCamera.fx: 1\n", "Camera.type"),
    "orb missing": ("Camera.fx: 500\n", "Camera.fy"),
    "rational": (ROS.format(model="rational_polynomial", distortion=R + ", 0, 0.1, 0, 0"), "rational"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_calibrations_are_refused_in_one_line_that_names_file_and_key(tmp_path, case):
    text, word = BROKEN[case]
    path = write(tmp_path, "bad camera é.yaml", text)
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
def test_broken_files_of_other_formats(tmp_path, name, text, word):
    with pytest.raises(CalibrationError, match=word) as caught:
        load_camera(write(tmp_path, name, text), (640, 480))
    assert len(str(caught.value).splitlines()) == 1


def test_missing_file_and_folder(tmp_path):
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
    "distortion that overflows": ("distortion: []", "distortion: [1.0e+200, 0, 0, 0]", "% of the image"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_impossible_calibrations_are_refused_before_they_make_a_map(tmp_path, case):
    good = "width: 640\nheight: 480\nfx: 520\nfy: 520\ncx: 320\ncy: 240\ndistortion: []\n"
    assert load_camera(write(tmp_path, "good.yaml", good)).fx == 520
    old, new, word = IMPOSSIBLE[case]
    with pytest.raises(CalibrationError, match=word) as caught:
        load_camera(write(tmp_path, "bad.yaml", good.replace(old, new)))
    assert len(str(caught.value).splitlines()) == 1


def test_a_key_that_is_given_the_same_value_twice_passes(tmp_path):
    text = "width: 640\nheight: 480\nfx: 520\nfx: 520\nfy: 520\ncx: 320\ncy: 240\n"
    assert load_camera(write(tmp_path, "c.yaml", text)).fx == 520


def test_a_pipe_that_nobody_writes_to_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CalibrationError, match="no regular file"):
        load_camera(tmp_path / "pipe")


def test_unsafe_yaml_runs_nothing(tmp_path):
    victim = tmp_path / "victim"
    path = write(tmp_path, "c.yaml", f"fx: !!python/object/apply:os.mkdir ['{victim}']\n")
    with pytest.raises(CalibrationError):
        load_camera(path)
    assert not victim.exists()
