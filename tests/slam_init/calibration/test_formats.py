"""Every calibration format gives the same camera; missing and impossible values are refused in one line."""

import io
import json
import math
import re

import numpy as np
import pytest
from calibration_texts import FORMATS, ORB2, OWN, RADTAN_COEFFICIENTS, ROS, SIZE, assert_refused, own
from make_files import write
from make_lenses import LENSES

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
        ("1 SIMPLE_FISHEYE 640 480 500 320 240", ("fisheye", (0, 0, 0, 0))),
        ("1 FISHEYE 640 480 500 500 320 240", ("fisheye", (0, 0, 0, 0))),
        ("1 SIMPLE_RADIAL_FISHEYE 640 480 500 320 240 0.1", ("fisheye", (0.1, 0, 0, 0))),
        ("1 RADIAL_FISHEYE 640 480 500 320 240 0.1 0.02", ("fisheye", (0.1, 0.02, 0, 0))),
        ("1 OPENCV_FISHEYE 640 480 500 500 320 240 .1 .02 .003 .004", ("fisheye", (0.1, 0.02, 0.003, 0.004))),
        ("1 FULL_OPENCV 640 480 500 500 320 240 .1 .2 .03 .04 0 0 0 0", ("radtan", (0.1, 0.2, 0.03, 0.04))),
        ("1 FULL_OPENCV 640 480 500 500 320 240 0.1 0.2 0 0 0 0.3 0 0", ("rational", (0.1, 0.2, 0, 0, 0, 0.3, 0, 0))),
        (
            "1 THIN_PRISM_FISHEYE 640 480 500 500 320 240 .1 .02 .001 .002 .01 .02 .003 .004",
            ("thin-prism-fisheye", (0.1, 0.02, 0.001, 0.002, 0.01, 0.02, 0.003, 0.004)),
        ),
        ("1 FOV 640 480 500 500 320 240 0.9", ("fov", (0.9,))),
        ("1 EUCM 640 480 500 500 320 240 0.6 1.1", ("eucm", (0.6, 1.1))),
        (
            "1 EQUIRECTANGULAR 640 480 640 480",
            Camera("equirectangular", 640, 480, 320 / math.pi, 480 / math.pi, 319.5, 239.5),
        ),
    ],
)
def test_every_camera_model_of_colmap_is_read(tmp_path, line, expected):
    camera = load_camera(write(tmp_path / "cameras.txt", line))
    if isinstance(expected, tuple):
        model, distortion = expected
        expected = Camera(model, 640, 480, 500, 500, 319.5, 239.5, distortion)
    assert camera == expected


FOCAL = "200, 201, 318, 241"


def kalibr(model, intrinsics, distortion="none", coefficients=""):
    return (
        f"cam0:\n  camera_model: {model}\n  intrinsics: [{intrinsics}]\n  distortion_model: {distortion}\n"
        f"  distortion_coeffs: [{coefficients}]\n  resolution: [640, 480]\n"
    )


def basalt(kind, **values):
    focal = {"fx": 200.0, "fy": 201.0, "cx": 318.0, "cy": 241.0}
    camera = {"camera_type": kind, "intrinsics": focal | values}
    return json.dumps({"value0": {"T_imu_cam": [{"px": 0.0}], "intrinsics": [camera], "resolution": [[640, 480]]}})


def camodocal(kind, projection, **others):
    parts = {"projection_parameters": projection, **others}
    text = "".join(
        f"{name}:\n" + "".join(f"   {key}: {value}\n" for key, value in values.items())
        for name, values in parts.items()
    )
    return f"%YAML:1.0\n---\nmodel_type: {kind}\ncamera_name: c\nimage_width: 640\nimage_height: 480\n{text}"


RADTAN4 = {"k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": 0.002}
OPENCV_K = "width: 640\nheight: 480\nK: [200, 0, 318, 0, 201, 241, 0, 0, 1]\n"
EIGHT = "0.1, 0.2, 0.001, 0.002, 0.01, 0.3, 0.02, 0.03"
EIGHT_VALUES = tuple(map(float, EIGHT.split(",")))


@pytest.mark.parametrize(
    ("name", "text", "model", "coefficients"),
    [
        ("c.yaml", kalibr("omni", f"1.2, {FOCAL}"), "omni", (1.2,)),
        (
            "c.yaml",
            kalibr("omni", f"1.2, {FOCAL}", "radtan", "-0.1, 0.02, 0.001, 0.002"),
            "omni",
            (1.2, -0.1, 0.02, 0.001, 0.002),
        ),
        ("c.yaml", kalibr("ds", f"-0.2, 0.6, {FOCAL}"), "double-sphere", (-0.2, 0.6)),
        ("c.yaml", kalibr("eucm", f"0.6, 1.1, {FOCAL}"), "eucm", (0.6, 1.1)),
        ("c.yaml", kalibr("pinhole", FOCAL, "fov", "0.9"), "fov", (0.9,)),
        ("c.json", basalt("ds", xi=-0.2, alpha=0.6), "double-sphere", (-0.2, 0.6)),
        ("c.json", basalt("eucm", alpha=0.6, beta=1.1), "eucm", (0.6, 1.1)),
        ("c.json", basalt("ucm", alpha=0.6), "eucm", (0.6, 1.0)),
        ("c.json", basalt("kb4", k1=0.1, k2=0.02, k3=0.003, k4=0.004), "fisheye", (0.1, 0.02, 0.003, 0.004)),
        ("c.json", basalt("pinhole"), "pinhole", ()),
        ("mei.yaml", camodocal("MEI", dict(zip(("gamma1", "gamma2", "u0", "v0"), (200, 201, 318, 241), strict=True)),
            mirror_parameters={"xi": 1.2}, distortion_parameters=RADTAN4), "omni", (1.2, -0.1, 0.02, 0.001, 0.002)),
        ("kb.yaml", camodocal("KANNALA_BRANDT", {"k2": 0.1, "k3": 0.02, "k4": 0.003, "k5": 0.004, "mu": 200,
            "mv": 201, "u0": 318, "v0": 241}), "fisheye", (0.1, 0.02, 0.003, 0.004)),
        ("ph.yaml", camodocal("PINHOLE", {"fx": 200, "fy": 201, "cx": 318, "cy": 241},
            distortion_parameters=RADTAN4), "radtan", tuple(RADTAN4.values())),
        ("ros.yaml", OPENCV_K + f"D: [{EIGHT}]\ndistortion_model: rational_polynomial\n", "rational", EIGHT_VALUES),
        ("cv.yaml", OPENCV_K + f"D: [{EIGHT}, .001, .002, .003, .004, 0, 0]\n",
            "thin-prism", (*EIGHT_VALUES, 0.001, 0.002, 0.003, 0.004)),
    ],
)  # fmt: skip
def test_every_lens_is_read_from_the_formats_that_have_it(tmp_path, name, text, model, coefficients):
    expected = Camera(model, 640, 480, 200, 201, 318, 241, coefficients)
    assert load_camera(write(tmp_path / name, text), (640, 480)) == expected


@pytest.mark.parametrize("model", LENSES)
def test_the_yaml_of_this_project_has_every_lens(tmp_path, model):
    lens = LENSES[model]
    keys = {"width": 640, "height": 480, "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy}
    text = own(**keys, distortion_model=model, distortion=list(lens.distortion))
    assert load_camera(write(tmp_path / "c.yaml", text)) == lens


def test_a_camera_without_distortion_is_a_pinhole_under_every_model_name(tmp_path):
    for model, distortion in (("none", "[]"), ("radtan", "[0, 0, 0, 0]"), ("pinhole", "[]")):
        camera = load_camera(write(tmp_path / "c.yaml", OWN.format(model=model, distortion=distortion)))
        assert (camera.model, camera.distortion) == ("pinhole", ())


def test_a_file_without_a_size_takes_that_of_the_images(tmp_path):
    path = write(tmp_path / "orb.yaml", ORB2)
    assert load_camera(path, (750, 490)).width == 750
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
    "text focal": (own(fx="wide"), "fx"),
    "boolean focal": (own(fx="yes"), "fx"),
    "list focal": (own(fx="[1, 2]"), "fx"),
    "missing focal": (own(fx=None), "fx"),
    "huge focal": (own(fx="1" + "0" * 400), "fx"),
    "half a pixel": (own(width=640.5), "whole"),
    "unknown model": (own(distortion_model="magic"), "distortion_model"),
    "omni without a mirror": (own(distortion_model="omni"), "xi"),
    "six coefficients": (own(distortion="[1, 2, 3, 4, 5, 6]", distortion_model="radtan"), "rational"),
    "text coefficient": (own(distortion="[0.1, x, 0, 0]"), "distortion"),
    "scalar distortion": (own(distortion="0.1", distortion_model="radtan"), "distortion"),
    "fisheye with two": (own(distortion="[0.1, 0]", distortion_model="fisheye"), "fisheye"),
    "other keys": ("name: camera\n", "no known calibration"),
    "short matrix": ("K: [1, 2, 3]\nwidth: 640\nheight: 480\n", "K"),
    "skewed matrix": ("K: [500, 4, 320, 0, 500, 240, 0, 0, 1]\nwidth: 640\nheight: 480\n", "skew"),
    "kalibr without": ("cam0: 3\n", "cam0"),
    "kalibr unknown": ("cam0: {camera_model: magic, intrinsics: [1, 2, 3, 4, 5]}\n", "camera_model"),
    "kalibr omni with four": ("cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4]}\n", "xi, fx, fy, cx, cy"),
    "kalibr omni equidistant": (
        "cam0: {camera_model: omni, intrinsics: [1, 500, 500, 320, 240], distortion_model: equidistant, "
        "distortion_coeffs: [0, 0, 0, 0], resolution: [640, 480]}\n",
        "distortion_model",
    ),
    "kalibr ds radtan": (
        "cam0: {camera_model: ds, intrinsics: [-0.2, 0.5, 200, 200, 320, 240], distortion_model: radtan, "
        "distortion_coeffs: [0.1, 0, 0, 0], resolution: [640, 480]}\n",
        "distortion_model",
    ),
    "camodocal unknown": ("model_type: SCARAMUZZA\nimage_width: 640\nimage_height: 480\n", "model_type"),
    "camodocal without mirror": (
        "model_type: MEI\nprojection_parameters: {gamma1: 500, gamma2: 500, u0: 320, v0: 240}\n"
        "distortion_parameters: {k1: 0, k2: 0, p1: 0, p2: 0}\n",
        "xi",
    ),
    "kalibr three": ("cam0: {intrinsics: [1, 2, 3], resolution: [640, 480]}\n", "intrinsics"),
    "orb unknown": ("Camera.type: Rolling\nCamera.fx: 1\n", "Camera.type"),
    "orb missing": ("Camera.fx: 500\n", "Camera.fy"),
    "tilted": (ROS.format(model="rational_polynomial", distortion=RADTAN_COEFFICIENTS + ", 0" * 9 + ", 0.1"), "tilted"),
}


def test_a_missing_or_impossible_value_is_refused_in_one_line_that_names_file_and_key(tmp_path):
    for text, word in BROKEN.values():
        assert_refused(write(tmp_path / "bad camera é.yaml", text), word)


def test_broken_colmap_and_xml_files_are_refused_in_one_line(tmp_path):
    for name, text, word in (
        ("cameras.txt", "", "empty"),
        ("cameras.txt", "# only a comment\n", "key: value"),
        ("cameras.txt", "1 PINHOLE 640 480 1 1 1 1\n2 PINHOLE 640 480 1 1 1 2\n", "2 cameras"),
        ("cameras.txt", "1 SIMPLE_DIVISION 640 480 1 1 1 1\n", "THIN_PRISM_FISHEYE"),
        ("cameras.txt", "1 FOV 640 480 500 500 320 240 4\n", "w of a fov"),
        ("cameras.txt", "1 PINHOLE 640 480 1 1 1\n", "4 parameters"),
        ("cameras.txt", "1 PINHOLE 640 480 x 1 1 1\n", "fx"),
        ("camera.json", "{", "JSON"),
        ("camera.json", '{"value0": 1, "value0": 2}', "twice"),
        ("camera.json", '{"value0": 1}', "value0"),
        ("camera.json", '{"value0": {"intrinsics": [], "resolution": []}}', "intrinsics"),
        ("camera.json", '{"value0": {"intrinsics": [{"camera_type": "kb9"}]}}', "camera_type"),
        ("camera.json", '{"value0": {"intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 200}}]}}', "fy"),
        ("camera.json", '{"value0": ' * 5000, "JSON"),
        ("camera.xml", "<opencv_storage><a>", "XML"),
        ("camera.xml", "<html></html>", "calibration|XML"),
    ):
        assert_refused(write(tmp_path / name, text), word)


# -- calibrations as people post them --------------------------------------------------------------


FLAT = """%YAML:1.0
Camera.name: "some camera"
Camera.setup: "monocular"
Camera.model: "MODEL"
Camera.fx: 192.5
Camera.fy: 192.0
Camera.cx: 319.5
Camera.cy: 239.5
Camera.k1: 0.02
Camera.k2: -0.01
Camera.k3: 0.003
Camera.k4: -0.001
Camera.cols: 640
Camera.rows: 480
Feature.name: "default"
"""
NESTED = re.sub(r"(?m)^Camera\.", "  ", FLAT.replace("Camera.name", "Camera:\n  name", 1)).replace("%YAML:1.0\n", "")
POSTED_ROS = """height: 480
width: 640
distortion_model: MODEL
d: [0.1, 0.2, 0.001, 0.002, 0.0]
k: [192.5, SKEW, 319.5, 0, 192, 239.5, 0, 0, 1]
---
"""
OST = """# oST version 5.0 parameters


[image]

width
640

height
480

[narrow_stereo]

camera matrix
192.5 0.000000 319.5
0.000000 192.0 239.5
0.000000 0.000000 1.000000

distortion
-0.1 0.02 0.001 0.002 0.000000

rectification
1.0 0.0 0.0
0.0 1.0 0.0
0.0 0.0 1.0
"""
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration><projection>TYPE</projection><width>640</width><height>480</height>
<f>192</f><cx>3</cx><cy>-2</cy><b1>0.5</b1><k1>0.02</k1><k2>-0.01</k2><p1>0.001</p1><p2>0.002</p2></calibration>
"""
MATRIX = "192.5 0 319.5\n0 192 239.5\n0 0 1\n"
OPENSFM = '{"v2 x 640 480 brown": {"projection_type": "brown", "width": 640, "height": 480, "focal_x": 0.8, "k1": 0.1}}'
OKVIS = "cameras:\n - {T_SC: [1], image_dimension: [640, 480], focal_length: [192, 192], principal_point: [320, 240]}\n"
LEFT_RIGHT = "".join(f"{side}:\n  fx: 192.5\n  fy: 192\n  cx: 320\n  cy: 240\n" for side in ("left", "right"))
COLMAP = "1 PINHOLE 640 480 192.5 192 320 240\n2 PINHOLE 640 480 192.5 {fy} 320 240\n"
RESULTS = (
    "Calibration results\n====================\nCamera-system parameters:\ncam0 (/cam0/image_raw):\n"
    "    distortion: [0.1 0.2 0 0] +- [0 0 0 0]\n    projection: [192 192 320 240] +- [1 1 1 1]\n"
)
ZED = "[LEFT_CAM_VGA]\nfx=192.5\nfy=192\ncx=320\ncy=240\nk1=-0.1\n\n[RIGHT_CAM_VGA]\nfx=192\n"

#: Text -> model and coefficients; all have fx 192.5, fy 192 and 640x480 images.
READ = {
    "openvslam fisheye": (FLAT.replace("MODEL", "fisheye"), "fisheye", (0.02, -0.01, 0.003, -0.001)),
    "stella fisheye": (NESTED.replace("MODEL", "fisheye"), "fisheye", (0.02, -0.01, 0.003, -0.001)),
    "stella beside parts with types": (
        NESTED.replace("MODEL", "fisheye") + "Feature:\n  type: ORB\n", "fisheye", (0.02, -0.01, 0.003, -0.001),
    ),
    "openvslam perspective": (
        re.sub("Camera.k[34].*", "", FLAT.replace("MODEL", "perspective")), "radtan", (0.02, -0.01, 0, 0),
    ),
    "ros": (POSTED_ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0"), "radtan", (0.1, 0.2, 0.001, 0.002)),
    "five of an equidistant": (
        POSTED_ROS.replace("MODEL", "equidistant").replace("SKEW", "0"), "fisheye", (0.1, 0.2, 0.001, 0.002),
    ),
    "ost": (OST, "radtan", (-0.1, 0.02, 0.001, 0.002)),
    "dso pinhole": ("192.5 192 319.5 239.5 0\n640 480\ncrop\n640 480\n", "pinhole", ()),
    "dso radtan": ("RadTan 192.5 192 319.5 239.5 0.1 0.2 0 0\n640 480\nnone\n640 480", "radtan", (0.1, 0.2, 0, 0)),
    "dso equidistant": ("EquiDistant 192.5 192 319.5 239.5 0 0 0 0\n640 480\n", "fisheye", (0, 0, 0, 0)),
    "dso fov": ("FOV 192.5 192 319.5 239.5 0.93\n640 480\n", "fov", (0.93,)),
    "dso fov, relative": (f"{192.5 / 640} 0.4 0.5 0.5 0.93\n640 480\ncrop\n640 480\n", "fov", (0.93,)),
    "dso pinhole, relative": (f"{192.5 / 640} 0.4 0.5 0.5 0\n640 480\nnone\n640 480\n", "pinhole", ()),
    "mast3r": (
        "width: 640\nheight: 480\ncalibration: [192.5, 192, 319.5, 239.5, 0.1, 0.2, 0, 0, 0.3]\n",
        "radtan", (0.1, 0.2, 0, 0, 0.3),
    ),
    "metashape": (METASHAPE.replace("TYPE", "frame"), "radtan", (0.02, -0.01, 0.002, 0.001)),
    "metashape fisheye": (
        METASHAPE.replace("TYPE", "fisheye"), "thin-prism-fisheye", (0.02, -0.01, 0.002, 0.001, 0, 0, 0, 0),
    ),
    "metashape with a calibration of EXIF before the adjusted one": (
        "<document><sensor><calibration><width>640</width><height>480</height><f>300</f></calibration>"
        + METASHAPE.partition("\n")[2].replace("TYPE", "frame") + "</sensor><sensor/></document>",
        "radtan", (0.02, -0.01, 0.002, 0.001),
    ),
    "matrix": (MATRIX, "pinhole", ()),
    "matrix of numpy": ("[[192.5, 0, 319.5],\n [0, 192, 239.5],\n [0, 0, 1]]", "pinhole", ()),
    "four numbers": ("# fx fy cx cy\n192.5, 192, 319.5, 239.5\n", "pinhole", ()),
    "no space": (
        "%YAML:1.0\n---\nimage_width:640\nimage_height:480\ncamera_matrix: !!opencv-matrix\n rows: 3\n cols: 3\n"
        " data: [192.5, 0, 319.5, 0, 192, 239.5, 0, 0, 1]\ndistortion_coefficients: !!opencv-matrix\n rows:1\n cols:4\n"
        " data: [0.1, 0.2, 0, 0]\n",
        "radtan", (0.1, 0.2, 0, 0),
    ),
    "intrinsics by name": (
        '{"width": 640, "height": 480, "intrinsics": {"fx": 192.5, "fy": 192, "cx": 319.5, "cy": 239.5}}',
        "pinhole", (),
    ),
    "equal cameras of colmap": (COLMAP.format(fy="192.0"), "pinhole", ()),
}  # fmt: skip
#: Text -> what the error names.
NAMED = {
    "results of kalibr": (RESULTS, "Kalibr.*camchain"),
    "opensfm": (OPENSFM, "OpenSfM"),
    "reconstruction of opensfm": (f'[{{"cameras": {OPENSFM}}}]', "OpenSfM"),
    "okvis": (OKVIS, "OKVIS"),
    "zed": (ZED, "ZED"),
    "left and right": (LEFT_RIGHT, "left, right"),
    "left and right below cameras": ("cameras:\n" + re.sub("(?m)^", "  ", LEFT_RIGHT), "left, right"),
    "zeros": ("width: 640\nheight: 480\nk: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n", "not calibrated"),
    "fisheye of ost": (OST.replace(" 0.002 0.000000", " 0.002"), "ost.yaml"),
    "two cameras of ost": (OST + OST, "several cameras"),
    "different cameras of colmap": (COLMAP.format(fy="193"), "2 cameras"),
    "skew": (POSTED_ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0.5"), "skew"),
    "two lists": (own(radial_distortion="[0.1, 0.2]", tangential_distortion="[0, 0]"), "radial.*tangential"),
    "numbers": ("1 2 3 4 5\n", "5 numbers"),
    "both": (
        own(model="fisheye", distortion_model="radtan"),
        "model states fisheye and distortion_model states radtan",
    ),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage/>', "document type"),
}


@pytest.mark.parametrize("suffix", ["yaml", "txt", "json"])
def test_a_posted_calibration_is_read_by_its_content_whatever_its_name(tmp_path, suffix):
    for name, (text, model, distortion) in READ.items():
        camera = load_camera(write(tmp_path / f"c.{suffix}", text), (640, 480))
        found = camera.model, camera.distortion, camera.fx, camera.fy, camera.width, camera.height
        assert found == (model, distortion, 192.5, 192, 640, 480), name
        centre = (322.5, 237.5) if "metashape" in name else (319.5, 239.5)
        assert (camera.cx, camera.cy) == centre, name


def test_a_form_that_is_not_read_is_named_in_one_line(tmp_path):
    for text, word in NAMED.values():
        assert_refused(write(tmp_path / "c.txt", text), word)


def test_an_archive_of_numpy_is_read_and_nothing_is_unpickled(tmp_path):
    K, boards = np.array([[192.5, 0, 319.5], [0, 192, 239.5], [0, 0, 1]]), np.array([{}], dtype=object)
    for names in (("K", "D"), ("mtx", "dist"), ("camera_matrix", "distCoeffs")):
        archive = io.BytesIO()
        np.savez(archive, **dict(zip(names, (K, [[0.1, 0.2, 0, 0, 0.3]]), strict=True)), rvecs=boards)
        camera = load_camera(write(tmp_path / "c.npz", archive.getvalue()), (640, 480))
        assert (camera.model, camera.fx, camera.distortion) == ("radtan", 192.5, (0.1, 0.2, 0, 0, 0.3))
    archive = io.BytesIO()
    np.savez(archive, K=boards)
    with pytest.raises(CalibrationError, match="allow_pickle=False"):
        load_camera(write(tmp_path / "c.npz", archive.getvalue()), (640, 480))


def test_a_skew_below_a_pixel_over_the_image_is_left_out_with_a_note(tmp_path):
    text = POSTED_ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0.3")  # 0.3 * 480 / 192 px
    (note,) = load_camera(write(tmp_path / "c.yaml", text)).notes
    assert "0.75 px" in note


def test_no_value_of_a_key_that_states_a_model_is_passed_over(tmp_path):
    keys = (
        *("model", "type", "Model", "camera_model", "cameraModel", "camera_type", "distortion_type", "lens_model"),
        *("projection_type", "calibration_model", "fisheye", "is_fisheye", "fisheye_model", "bFishEye"),
        "distortionModel",
    )
    cases = [own() + f"{key}: squint\n" for key in keys]
    cases += [FLAT.replace("Camera.model", f"Camera.{key}") for key in ("model", "type", "Type", "distortion_model")]
    cases += [NESTED, POSTED_ROS.replace("SKEW", "0"), "lens_model: squint\n" + NESTED.replace("MODEL", "fisheye")]
    for name, (text, _) in FORMATS.items():  # each value that a format of a known camera states
        stated = re.compile(r"(?m)^(\s*(?:Camera\.)?(?:\w*_model|model|type): ).*$")
        cases += [stated.sub(r"\1squint", text)] if stated.search(text) and not name.endswith("xml") else []
    for text in cases:
        assert_refused(write(tmp_path / "c.yaml", text), r"squint|MODEL")
