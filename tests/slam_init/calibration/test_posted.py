"""Calibrations as people post them: the lens and the size that they state, or an error that names their form."""

import io
import re

import numpy as np
import pytest
from calibration_texts import FORMATS, assert_refused, own
from make_files import write

from slam_init.calibration.files import load_camera
from slam_init.errors import CalibrationError

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
ROS = """height: 480
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
    "ros": (ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0"), "radtan", (0.1, 0.2, 0.001, 0.002)),
    "five of an equidistant": (
        ROS.replace("MODEL", "equidistant").replace("SKEW", "0"), "fisheye", (0.1, 0.2, 0.001, 0.002),
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
    "skew": (ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0.5"), "skew"),
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
    text = ROS.replace("MODEL", "plumb_bob").replace("SKEW", "0.3")  # 0.3 * 480 / 192 px
    (note,) = load_camera(write(tmp_path / "c.yaml", text)).notes
    assert "0.75 px" in note


def test_no_value_of_a_key_that_states_a_model_is_passed_over(tmp_path):
    keys = ("model", "type", "Model", "camera_model", "cameraModel", "camera_type", "distortion_type", "lens_model")
    keys += (
        "projection_type",
        "calibration_model",
        "fisheye",
        "is_fisheye",
        "fisheye_model",
        "bFishEye",
        "distortionModel",
    )
    cases = [own() + f"{key}: squint\n" for key in keys]
    cases += [FLAT.replace("Camera.model", f"Camera.{key}") for key in ("model", "type", "Type", "distortion_model")]
    cases += [NESTED, ROS.replace("SKEW", "0"), "lens_model: squint\n" + NESTED.replace("MODEL", "fisheye")]
    for name, (text, _) in FORMATS.items():  # each value that a format of a known camera states
        stated = re.compile(r"(?m)^(\s*(?:Camera\.)?(?:\w*_model|model|type): ).*$")
        cases += [stated.sub(r"\1squint", text)] if stated.search(text) and not name.endswith("xml") else []
    for text in cases:
        assert_refused(write(tmp_path / "c.yaml", text), r"squint|MODEL")
