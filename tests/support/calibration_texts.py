"""The same two cameras, written in every calibration format that can be read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from slam_init.calibration.files import load_camera
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

SIZE = (752, 480)
RADTAN = Camera("radtan", *SIZE, 458.5, 457.25, 367.25, 248.5, (-0.28, 0.07, 0.0002, 1.76e-05))
FISHEYE = Camera("fisheye", *SIZE, 458.5, 457.25, 367.25, 248.5, (0.003, 0.0007, -0.002, 0.0002))
#: The YAML of this project.
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
OPENCV_KD = re.sub("(?m)^---.*|^image_.*", "", OPENCV).replace("camera_matrix", "K")
OPENCV_KD = OPENCV_KD.replace("distortion_coefficients", "D").replace("cols: 5", "cols: 4").replace(", 0. ]\n", " ]\n")
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
#: Distortion coefficients of RADTAN and of FISHEYE.
RADTAN_COEFFICIENTS = "-0.28, 0.07, 0.0002, 1.76e-05"
FISHEYE_COEFFICIENTS = "0.003, 0.0007, -0.002, 0.0002"
#: File name -> text and expected camera.
FORMATS = {
    "own.yaml": (OWN.format(model="radtan", distortion=f"[{RADTAN_COEFFICIENTS}]"), RADTAN),
    "own_fisheye.yaml": (OWN.format(model="fisheye", distortion=f"[{FISHEYE_COEFFICIENTS}]"), FISHEYE),
    "own_equidistant.yaml": (OWN.format(model="equidistant", distortion=f"[{FISHEYE_COEFFICIENTS}]"), FISHEYE),
    "opencv.yaml": (OPENCV, RADTAN),
    "opencv_kd.yml": (OPENCV_KD, RADTAN),
    "opencv.xml": (OPENCV_XML, RADTAN),
    "orb2.yaml": (ORB2, RADTAN),
    "orb3.yaml": (ORB3_FISHEYE, FISHEYE),
    "kalibr.yaml": (KALIBR.format(model="radtan", distortion=RADTAN_COEFFICIENTS), RADTAN),
    "kalibr_fisheye.yaml": (KALIBR.format(model="equidistant", distortion=FISHEYE_COEFFICIENTS), FISHEYE),
    "sensor.yaml": (EUROC, RADTAN),
    "ros.yaml": (ROS.format(model="plumb_bob", distortion=RADTAN_COEFFICIENTS + ", 0"), RADTAN),
    "ros_rational.yaml": (
        ROS.format(model="rational_polynomial", distortion=RADTAN_COEFFICIENTS + ", 0, 0, 0, 0"),
        RADTAN,
    ),
    "ros_equidistant.yaml": (ROS.format(model="equidistant", distortion=FISHEYE_COEFFICIENTS), FISHEYE),
    "camera_info.yaml": (ROS_TOPIC, RADTAN),
    "cameras.txt": (
        f"# Camera list\n1 OPENCV 752 480 458.5 457.25 367.75 249 {RADTAN_COEFFICIENTS.replace(',', '')}\n",
        RADTAN,
    ),
}


def own(**changes: object) -> str:
    """The YAML of this project for a camera without distortion; a value of None removes the line."""
    values = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240} | changes
    return "".join(f"{key}: {value}\n" for key, value in values.items() if value is not None)


def assert_refused(path: Path, word: str) -> None:
    """The calibration in a file is refused by a message that names the file and matches ``word``."""
    with pytest.raises(CalibrationError, match=word) as caught:
        load_camera(path, (640, 480))
    assert str(path) in str(caught.value), word
