"""Laws of the calibration from a whole video."""

import math
from dataclasses import replace

import pytest

from slam_init.calibration.files import load_camera
from slam_init.calibration.prior import prior_camera
from slam_init.calibration.writing import camera_yaml
from slam_init.methods.self_calibration import StretchEstimate, combine

PRIOR = prior_camera((640, 480))


def stretch(focal_px, sigma, k1=0.0, k1_sigma=0.01):
    return StretchEstimate(0, 10, focal_px, sigma, k1, k1_sigma)


def test_without_an_estimate_there_is_no_camera():
    assert combine(PRIOR, []).camera is None


def test_stretches_that_agree_make_the_estimate_more_certain():
    one, four = (combine(PRIOR, [stretch(500.0, 0.04)] * count).camera for count in (1, 4))
    assert one.fx == pytest.approx(500) and four.fx == pytest.approx(500)
    assert 0.45 < four.focal_sigma / one.focal_sigma < 0.56


def test_stretches_that_contradict_each_other_do_not():
    camera = combine(PRIOR, [stretch(450.0, 0.01), stretch(550.0, 0.01)]).camera
    assert camera.focal_sigma > 0.05


def test_the_certain_stretch_counts_more():
    camera = combine(PRIOR, [stretch(500.0, 0.01), stretch(600.0, 0.1)]).camera
    assert abs(math.log(camera.fx / 500)) < 0.01


def test_a_distortion_is_stated_where_it_is_certain():
    bent = combine(PRIOR, [stretch(500.0, 0.02, k1=-0.2)] * 2).camera
    assert bent.distortion[0] == pytest.approx(-0.2)
    assert combine(PRIOR, [stretch(500.0, 0.02, k1=0.005)]).camera.distortion == ()


def test_the_file_is_read_back(tmp_path):
    camera = combine(PRIOR, [stretch(500.0, 0.04, k1=-0.2)]).camera
    (tmp_path / "camera.yaml").write_text(camera_yaml(camera))
    read = load_camera(tmp_path / "camera.yaml", (640, 480))
    assert read == replace(camera, source="file")
    assert (read.source, read.focal_sigma) == ("file", camera.focal_sigma)
