"""Laws of the calibration from a whole video."""

import math
from dataclasses import replace

import pytest

from slam_init.calibration.files import load_camera
from slam_init.calibration.prior import prior_camera
from slam_init.calibration.writing import camera_yaml
from slam_init.decision.lens import advice_on
from slam_init.methods.self_calibration import StretchEstimate, combine
from slam_init.types.lens_in_use import MAX_FOCAL_SIGMA, LensInUse

PRIOR = prior_camera((640, 480))


def stretch(focal_px, sigma, k1=0.0, k1_sigma=0.01):
    return StretchEstimate(0, 10, focal_px, sigma, k1, k1_sigma)


def test_without_an_estimate_there_is_no_camera():
    assert combine(PRIOR, []).camera is None


def test_stretches_that_agree_make_the_estimate_more_certain():
    one, four = (combine(PRIOR, [stretch(500.0, 0.04)] * count).camera for count in (1, 4))
    assert one.fx == pytest.approx(500) and four.fx == pytest.approx(500)
    assert 0.45 < four.focal_sigma / one.focal_sigma < 0.56


def test_stretches_that_contradict_each_other_give_no_camera():
    found = combine(PRIOR, [stretch(450.0, 0.01), stretch(550.0, 0.01)])
    assert found.focal_sigma > MAX_FOCAL_SIGMA
    assert found.camera is None


@pytest.mark.parametrize("sigma", [0.5 * MAX_FOCAL_SIGMA, 1.01 * MAX_FOCAL_SIGMA])
def test_a_camera_is_written_at_the_bound_at_which_a_map_without_a_calibration_is_handed_over(sigma):
    assert (combine(PRIOR, [stretch(500.0, sigma)]).camera is None) == (sigma > MAX_FOCAL_SIGMA)


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


def test_the_advice_about_an_unknown_focal_length_does_not_ask_for_what_was_given():
    given = replace(PRIOR, source="stated", focal_sigma=0.05)
    advice = advice_on(LensInUse.of(given))
    assert "fov" not in advice and "f=" not in advice
    assert advice_on(LensInUse.of(PRIOR)) is None  # that of the reason
    assert advice_on(LensInUse.of(PRIOR).moved(math.log(0.5), 0.0)).startswith("wide lens: give")
