"""Large images are tracked at a reduced size; maps are given in original pixels, with the same residuals."""

from dataclasses import replace

import numpy as np
import pytest
from make_bundle import FOCAL, ROTATING
from make_files import picture
from make_map import CAMERAS, make_map, make_result
from make_scene import cloud, problem

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.config import Config
from slam_init.mapping.reduction import TRACKED_SIDE, Reduction
from slam_init.types.camera import Camera
from slam_init.types.evidence import FreeFocal
from slam_init.types.frame import Frame
from slam_init.types.refusal import Verdict

LARGE = Camera("radtan", 2731, 1802, 2100.0, 2110.0, 1365.0, 900.5, (0.02, -0.01, 0.001, 0.0))


def result_with(map_):
    return replace(make_result(make_map()), map=map_, hypotheses=(map_,))


def enlarged_camera(model):
    """The camera whose images, reduced by three, are those of the model."""
    small = CAMERAS[model]
    return replace(small.scaled(3), width=3 * small.width + 2, height=3 * small.height + 1)


@pytest.mark.parametrize("side", [64, 1280, 1920, 2 * TRACKED_SIDE - 1])
def test_images_below_twice_the_tracked_side_are_not_touched(side):
    camera = Camera("pinhole", side, side // 2, side, side, side / 2, side / 4)
    frame = Frame(0, 0.0, "", np.zeros((side // 2, side), np.uint8))
    reduction = Reduction.for_camera(camera)
    assert reduction.camera is camera and reduction.notes == ()
    assert next(reduction.frames(iter([frame]))) is frame
    result = make_result(make_map())
    assert reduction.enlarged(result) is result


def test_a_reduced_pixel_is_the_mean_of_a_square_and_sees_the_ray_of_its_middle():
    reduction = Reduction.for_camera(LARGE)
    n, small = reduction.factor, reduction.camera
    assert (n, small.width, small.height) == (2, 1365, 901)
    image = picture(3, (LARGE.width, LARGE.height), 1)
    mask = np.full(image.shape, 255, np.uint8)
    mask[600, 801] = 0
    (frame,) = reduction.frames(iter([Frame(4, 0.1, "a", image, mask)]))
    assert frame.image.shape == frame.mask.shape == (901, 1365)
    squares = image[:1802, :2730].reshape(901, 2, 1365, 2).mean(axis=(1, 3))
    assert np.abs(frame.image - squares).max() <= 0.5
    assert np.argwhere(frame.mask == 0).tolist() == [[300, 400]]
    pixels = np.array([[0.0, 0.0], [700.0, 300.0], [1364.0, 900.0]])
    np.testing.assert_allclose(small.bearings(pixels), LARGE.bearings(2 * pixels + 0.5), atol=1e-9)


@pytest.mark.parametrize(
    ("model", "config"), [("pinhole", FOCAL), ("radtan", Config().map), ("radtan5", FOCAL), ("fisheye", Config().map)]
)
def test_the_enlarged_graph_has_the_same_residuals_by_the_camera_of_the_original_images(model, config):
    rng = np.random.default_rng(6)
    small = CAMERAS[model] if config is not FOCAL else camera_with_focal_factor(CAMERAS[model], 1.03)
    noisy = problem(CAMERAS[model], cloud(rng, 40), ROTATING, 0.3, rng)
    solution = adjust(small, noisy, config)
    large = replace(small.scaled(3), width=3 * small.width + 2, height=3 * small.height + 1)
    map_ = replace(
        make_map(model), recipe=solution.recipe, camera=solution.camera,
        noise_px=solution.noise_px, observation_pixels=solution.problem.pixels,
    )  # fmt: skip
    given = Reduction(large, 3, small).enlarged(result_with(map_)).map
    assert given.camera.width == large.width
    assert given.camera.focal_px == pytest.approx(3 * solution.camera.focal_px)
    assert given.graph.size() == solution.recipe.graph.size()
    for number in range(given.graph.size()):
        expected = solution.recipe.graph.at(number).error(solution.recipe.values)
        assert given.graph.at(number).error(given.values) == pytest.approx(expected, rel=1e-5, abs=1e-6)
    residuals = (
        given.camera.project(np.array([[0.1, -0.2, 1.5]])),
        solution.camera.project(np.array([[0.1, -0.2, 1.5]])),
    )
    np.testing.assert_allclose(residuals[0] + 0.5, 3 * (residuals[1] + 0.5), atol=1e-6)


def test_poses_and_points_stay_and_pixels_and_their_errors_grow():
    small = make_map()
    large = Reduction(enlarged_camera("pinhole"), 3, small.camera).enlarged(result_with(small))
    assert large.hypotheses[0] is large.map
    assert np.array_equal(large.map.points, small.points) and large.map.keyframes is small.keyframes
    np.testing.assert_allclose(large.map.observation_pixels, 3 * small.observation_pixels + 1)
    open_pixels = large.map.open_tracks.pixels
    np.testing.assert_allclose(open_pixels, 3 * small.open_tracks.pixels + 1)
    np.testing.assert_allclose(large.map.camera.bearings(open_pixels), small.open_tracks.bearings, atol=1e-9)
    assert large.map.reprojection_rmse_px == pytest.approx(3 * small.reprojection_rmse_px)
    assert large.map.noise_px == pytest.approx(3 * small.noise_px)
    assert (large.map.camera.width, large.map.camera.height) == (3 * 640 + 2, 3 * 480 + 1)


def test_a_wrong_focal_length_is_reported_in_original_pixels():
    wrong = FreeFocal(615.0, 308.0, 11.0, contradicts=True)
    result = replace(
        make_result(None, Verdict.LOW_PARALLAX), wrong_focal=wrong, notes=("a", wrong.note), advice=wrong.note
    )
    enlarged = Reduction.for_camera(LARGE).enlarged(result)
    assert enlarged.wrong_focal == FreeFocal(1230.0, 616.0, 22.0, contradicts=True)
    assert enlarged.notes == ("a", enlarged.wrong_focal.note)
    assert enlarged.advice == enlarged.wrong_focal.note
