"""The estimate from pixels: agreement with the estimate from bearings, and the refusal of wrong cameras and points."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, box, plane, views

from quest import InputError, NoPose, estimate_relative_pose, estimate_relative_pose_px

K1 = np.array([[458.0, 0.0, 320.0], [0.0, 460.0, 240.0], [0.0, 0.0, 1.0]])
K2 = np.array([[700.0, 1.5, 500.0], [0.0, 690.0, 380.0], [0.0, 0.0, 1.0]])
MEAN_FOCAL_PX = (458 + 460 + 700 + 690) / 4


def pixels_of(rays, K):
    """Pixels (N, 2) of rays (N, 3)."""
    projected = rays @ K.T
    return projected[:, :2] / projected[:, 2:]


@pytest.mark.parametrize(
    ("scene", "options"),
    [(box, {}), (plane, {}), (box, {"t": NO_TRANSLATION})],
    ids=["general", "planar", "rotation"],
)
def test_the_pose_is_that_of_the_bearings(request, scene, options):
    m, n = views(scene(0), noise_rad=NOISE_RAD, outliers=0.3, **options)
    found = estimate_relative_pose_px(pixels_of(m, K1), pixels_of(n, K2), K1, K2, threshold_px=1.2, seed=3)
    expected = estimate_relative_pose(m, n, threshold_rad=1.2 / MEAN_FOCAL_PX, seed=3)
    assert found.kind == expected.kind == request.node.callspec.id
    assert pytest.approx(expected.R, abs=1e-6) == found.R
    assert found.t == pytest.approx(expected.t, abs=1e-5)
    assert (found.inliers == expected.inliers).mean() > 0.99


def test_lists_options_and_results_are_those_of_the_bearing_function():
    m, n = views(box(0), noise_rad=NOISE_RAD)
    points1, points2 = pixels_of(m, K1).tolist(), pixels_of(n, K1).tolist()
    options = {"seed": 5, "confidence": 0.99, "max_samples": 200, "scores": range(200)}
    assert estimate_relative_pose_px(points1, points2, K1.tolist(), **options).kind == "general"
    assert isinstance(estimate_relative_pose_px(points1[:4], points2[:4], K1, K1), NoPose)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K1": np.eye(4)}, r"K1 has shape \(4, 4\)"),
        ({"K2": np.full((3, 3), np.nan)}, "K2 .* finite"),
        ({"K1": np.diag([0.0, 500.0, 1.0])}, "K1 has the focal lengths 0 and 500"),
        ({"K1": np.diag([500.0, 500.0, 2.0])}, "K1 is no camera matrix"),
        ({"K1": K1 + np.diag([1.0, 0.0], -1)}, "K1 is no camera matrix"),
        ({"points1": np.ones((20, 3))}, r"points1 have shape \(20, 3\)"),
        ({"points2": np.ones(20)}, r"points2 have shape \(20,\)"),
        ({"points2": np.full((20, 2), np.inf)}, "points2 .* not finite"),
        ({"points2": np.ones((21, 2))}, "one shape"),
        ({"threshold_px": 0.0}, "threshold_px"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_arguments_are_named(change, message):
    arguments = {"points1": np.ones((20, 2)), "points2": np.ones((20, 2)), "K1": K1, "K2": K2} | change
    with pytest.raises(InputError, match=message):
        estimate_relative_pose_px(**arguments)
