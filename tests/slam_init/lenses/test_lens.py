"""Laws of the lens models: projecting and unprojecting are inverse, and other programs compute the same pixels."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from make_lenses import LENSES, directions

from slam_init.types.camera import Camera

UNIT = st.floats(0.0, 1.0)


def between(low, high):
    return UNIT.map(lambda part: low + part * (high - low))


#: The range of each coefficient of real lenses, by model.
PERSPECTIVE = (
    (-0.3, 0.6), (-0.1, 0.2), (-2e-3, 2e-3), (-2e-3, 2e-3), (-0.02, 0.04), (0.0, 0.8), (0.0, 0.3), (0.0, 0.05)
)  # fmt: skip
COEFFICIENTS = {
    "rational": PERSPECTIVE,
    "thin-prism": (*PERSPECTIVE, *(4 * ((-2e-3, 2e-3),))),
    "fisheye": ((-0.05, 0.1), (-0.03, 0.03), (-0.01, 0.01), (-3e-3, 3e-3)),
    "thin-prism-fisheye": (
        (-0.05, 0.1), (-0.03, 0.03), (-1e-3, 1e-3), (-1e-3, 1e-3), (-0.01, 0.01), (-3e-3, 3e-3), *(2 * ((-1e-3, 1e-3),))
    ),
    "fov": ((0.05, 2.0),),
    "omni": ((0.5, 3.0), (-0.2, 0.2), (-0.05, 0.1), (-1e-3, 1e-3), (-1e-3, 1e-3)),
    "double-sphere": ((-0.6, 1.0), (0.0, 0.9)),
    "eucm": ((0.0, 0.95), (0.3, 3.0)),
    "equirectangular": (),
}  # fmt: skip


@settings(max_examples=8, phases=[Phase.generate])
@given(st.data(), st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("model", COEFFICIENTS)
def test_the_pixel_of_a_ray_has_this_ray_and_the_ray_of_a_pixel_has_this_pixel_over_the_whole_field(model, data, seed):
    coefficients = tuple(data.draw(between(*one)) for one in COEFFICIENTS[model])
    camera = replace(LENSES[model], fx=200.0, fy=204.0, distortion=coefficients)
    if camera.lens is None:  # a fisheye whose polynomial turns before 89 degrees
        return
    rays = directions(150, seed)
    pixels = camera.project(2.5 * rays)
    seen = np.isfinite(pixels).all(axis=1)
    found = camera.bearings(pixels[seen])
    if model != "equirectangular":
        angles = np.arctan2(np.hypot(*rays[:, :2].T), rays[:, 2])
        np.testing.assert_array_equal(seen, angles <= camera.lens.max_angle_rad)
        # The border of the field lies on a pixel up to rounding, and up to the terms that are not radial.
        inner = np.arctan2(np.hypot(*rays[seen, :2].T), rays[seen, 2]) < camera.lens.max_angle_rad - 2e-2
        found, seen = found[inner], np.flatnonzero(seen)[inner]
    np.testing.assert_allclose(found, rays[seen], atol=1e-8)
    image = np.random.default_rng(seed).uniform((0, 0), (639, 479), (150, 2))
    known = np.isfinite(camera.bearings(image)).all(axis=1)
    again = camera.project(camera.bearings(image[known]))
    np.testing.assert_allclose(again, image[known], atol=1e-8 * camera.fx)


@pytest.mark.parametrize("model", LENSES)
def test_the_centre_looks_along_the_axis_with_the_stated_pixels_per_radian(model):
    camera = LENSES[model]
    rays = np.array([[0.0, 0.0, 1.0], [1e-6, 0.0, 1.0], [0.0, 1e-6, 1.0]])
    centre, right, down = camera.project(rays)
    np.testing.assert_allclose(centre, [camera.cx, camera.cy], atol=1e-12)
    np.testing.assert_allclose([right[0] - centre[0], down[1] - centre[1]], 1e-6 * np.diagonal(camera.K)[:2], rtol=1e-4)
    assert camera.focal_px == pytest.approx(math.sqrt(camera.K[0, 0] * camera.K[1, 1]))


@pytest.mark.parametrize("model", ["rational", "thin-prism"])
def test_opencv_projects_to_the_same_pixels(model):
    camera, points = LENSES[model], np.random.default_rng(1).uniform([-1, -0.8, 0.9], [1, 0.8, 4], (200, 3))
    zero = np.zeros(3)
    expected, _ = cv2.projectPoints(points, zero, zero, camera.K, np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


COLMAP = {
    "rational": "FULL_OPENCV",
    "thin-prism-fisheye": "THIN_PRISM_FISHEYE",
    "fisheye": "OPENCV_FISHEYE",
    "fov": "FOV",
    "eucm": "EUCM",
    "equirectangular": "EQUIRECTANGULAR",
}


@pytest.mark.parametrize("model", COLMAP)
def test_colmap_projects_to_the_same_pixels(model):
    if not hasattr(pycolmap.CameraModelId, COLMAP[model]):
        pytest.skip(f"this pycolmap has no {COLMAP[model]}")
    camera, rays = LENSES[model], directions(300)
    # On the plane z = 1 COLMAP has no rays behind it.
    rays = rays if model == "equirectangular" else rays[rays[:, 2] > 0.2]
    rays = rays[np.isfinite(camera.project(rays)).all(axis=1)]
    parameters = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, *camera.distortion]
    if model == "equirectangular":
        parameters = [camera.width, camera.height]
    theirs = pycolmap.Camera(model=COLMAP[model], width=camera.width, height=camera.height, params=parameters)
    expected = np.array([theirs.img_from_cam(ray) for ray in rays]) - 0.5
    assert len(rays) > 80
    np.testing.assert_allclose(camera.project(rays), expected, atol=1e-8)


@settings(max_examples=20)
@given(between(0.0, 0.9), between(0.0, 2.0))
def test_the_models_on_a_sphere_meet_where_one_is_a_case_of_the_other(alpha, xi):
    rays = directions(100)

    def pixels(model, focal_px, *coefficients):
        return Camera(model, 640, 480, focal_px, focal_px, 320, 240, coefficients).project(rays)

    np.testing.assert_allclose(pixels("double-sphere", 200, 0.0, alpha), pixels("eucm", 200, alpha, 1.0), atol=1e-9)
    if xi <= 1:
        np.testing.assert_allclose(pixels("double-sphere", 200, xi, 0.0), pixels("omni", 200, xi), atol=1e-9)
    # The unified model in the form of Basalt: alpha = xi / (1 + xi), and a focal length that is 1 + xi times as short.
    unified = pixels("eucm", 200 / (1 + xi), xi / (1 + xi), 1.0)
    both = np.isfinite(unified) & np.isfinite(pixels("omni", 200, xi))
    np.testing.assert_allclose(pixels("omni", 200, xi)[both], unified[both], atol=1e-8)
    assert both.any()


def test_a_fisheye_sees_beyond_the_image_plane_only_where_its_image_does():
    wide = LENSES["fisheye"]
    behind = np.array([[math.sin(math.radians(95)), 0.0, math.cos(math.radians(95))]])
    np.testing.assert_allclose(wide.bearings(wide.project(behind)), behind, atol=1e-12)
    narrow = replace(wide, fx=400.0, fy=402.0)
    assert narrow.lens is None
    assert np.isnan(narrow.project(behind)).all()
    # Where both see a ray, the formula on the plane z = 1 and the lens agree.
    rays = directions(300)
    rays = rays[rays[:, 2] > 0.1]
    np.testing.assert_allclose(
        (wide.project(rays) - (wide.cx, wide.cy)) / (wide.fx, wide.fy),
        (narrow.project(rays) - (narrow.cx, narrow.cy)) / (narrow.fx, narrow.fy),
        atol=1e-12,
    )


def test_the_plane_has_places_for_rays_in_front_only():
    camera = LENSES["double-sphere"]
    rays = np.array([[0.6, 0.0, 0.8], [0.8, 0.0, -0.6]])
    places = camera.normalize(camera.project(rays))
    np.testing.assert_allclose(places[0], [0.75, 0.0], atol=1e-12)
    assert np.isnan(places[1]).all()
    assert camera.widest_rad > math.pi / 2


def test_a_panorama_ends_before_its_seam_and_its_poles_and_is_not_bent():
    camera = LENSES["equirectangular"]
    assert camera.bent(0.1) == camera
    rays = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.0]])
    assert np.isfinite(camera.project(rays)).all(axis=1).tolist() == [False, True, False, True, False]


@pytest.mark.parametrize("model", [model for model in LENSES if model != "equirectangular"])
def test_a_bent_lens_moves_a_pixel_by_the_cube_of_its_angle(model):
    camera, angle = LENSES[model], 0.02
    ray = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
    moved = (camera.bent(0.1).project(ray) - camera.project(ray))[0, 0] / camera.K[0, 0]
    assert moved == pytest.approx(0.1 * angle**3, rel=1e-2)
