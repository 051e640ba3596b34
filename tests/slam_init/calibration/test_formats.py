"""Every calibration format gives the same camera; missing and impossible values are refused in one line."""

import json
import math
import re

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
        path = write(tmp_path / "bad camera é.yaml", text)
        assert_refused(path, word)
        assert_refused(path, re.escape(str(path)))


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
