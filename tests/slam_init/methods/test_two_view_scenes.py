"""The scenes of the table of heuristics: fixed draws, which obey their own truth."""

import numpy as np
import pytest
from two_view_scenes import CAMERA, KINDS, make_scene

from slam_init.types.pose import Pose

#: For each kind, the first pixel of the first view and the last pixel of the second view.
EXPECTED_PIXELS = {
    "general": [[336.34157727, 49.38720224], [60.73156529, 355.18337036]],
    "plane": [[335.63842634, 49.74014236], [571.25191659, 3.26636505]],
    "nadir": [[335.89143514, 51.43941919], [398.92502543, 92.1799578]],
    "rotation": [[336.34157727, 49.38720224], [629.32251979, 367.89854375]],
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_the_random_draws_is_part_of_the_definition(kind):
    """The program that made the table printed these pixels."""
    scene = make_scene(kind, 0.15, 7000)
    assert len(scene.pixels1) == 400
    assert (~scene.inliers).sum() == 40
    np.testing.assert_allclose([scene.pixels1[0], scene.pixels2[399]], EXPECTED_PIXELS[kind], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_matches_obey_the_true_motion(kind):
    scene = make_scene(kind, 0.2, 3, noise_px=0.0)
    m, n = CAMERA.bearings(scene.pixels1)[scene.inliers], CAMERA.bearings(scene.pixels2)[scene.inliers]
    rotated, t = m @ scene.cam2_from_cam1.R.T, scene.cam2_from_cam1.t
    if kind == "rotation":
        np.testing.assert_allclose(rotated, n, atol=1e-9)
        assert not scene.is_correct(scene.cam2_from_cam1)
    else:
        np.testing.assert_allclose(np.cross(rotated, n) @ t, 0, atol=1e-9)
        assert scene.is_correct(scene.cam2_from_cam1)
        assert not scene.is_correct(Pose(scene.cam2_from_cam1.R, -t))


def test_an_unknown_kind_is_an_error():
    with pytest.raises(ValueError, match="use one of general"):
        make_scene("cube", 0.2, 3)
