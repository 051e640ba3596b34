"""COLMAP reads the model, and computes the same reprojection errors."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from make_lenses import LENSES, directions
from make_map import CAMERAS, make_map

from slam_init.output.colmap import colmap_model, colmap_note
from slam_init.output.names import COLMAP_FILES


def read_by_colmap(folder, map_):
    """The model of a map, written and read back by COLMAP."""
    for name, text in zip(COLMAP_FILES, colmap_model(map_).texts(), strict=True):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(text)
    return pycolmap.Reconstruction(folder / "colmap")


@pytest.mark.parametrize("model", CAMERAS)
def test_colmap_reads_the_model_and_computes_the_same_reprojection_errors(tmp_path, model):
    map_, camera = make_map(model), CAMERAS[model]
    read = read_by_colmap(tmp_path, map_)
    expected = {"pinhole": "PINHOLE", "radtan": "OPENCV", "radtan5": "FULL_OPENCV", "fisheye": "OPENCV_FISHEYE"}
    assert read.cameras[1].model.name == expected[model]
    assert [read.images[k + 1].name for k in range(4)] == [k.name for k in map_.keyframes]
    assert read.num_points3D() == len(map_.points)
    assert read.compute_num_observations() == len(map_.observation_pixels)

    written_px = {i: point.error for i, point in read.points3D.items()}
    read.update_point_3d_errors()
    for i, point in read.points3D.items():
        assert point.error == pytest.approx(written_px[i], abs=1e-6)
    errors_px = []
    for k, i, pixel in zip(
        map_.observation_keyframes, map_.observation_landmarks, map_.observation_pixels, strict=True
    ):
        cam_from_world = map_.keyframes[k].world_from_cam.inverse()
        errors_px.append(np.linalg.norm(camera.project(cam_from_world.apply(map_.points[i]))[0] - pixel))
    assert np.sqrt(np.mean(np.square(errors_px))) == pytest.approx(map_.reprojection_rmse_px)
    by_point = [np.mean(np.array(errors_px)[map_.observation_landmarks == i]) for i in range(len(map_.points))]
    assert read.compute_mean_reprojection_error() == pytest.approx(np.mean(by_point), abs=1e-6)


def map_through(camera):
    """The map of another test, seen by a lens: points ahead, beside and, in the last keyframe, behind the camera."""
    map_ = make_map()
    points = map_.points.copy()
    points[:20] = [1.0, 0.1, 0.06] + 0.05 * directions(20)
    pixels = np.concatenate(
        [
            camera.project(pose.world_from_cam.inverse().apply(points[map_.observation_landmarks[mine]]))
            for k, pose in enumerate(map_.keyframes)
            if (mine := map_.observation_keyframes == k).any()
        ]
    )
    noisy = pixels + np.random.default_rng(2).normal(0, 0.2, pixels.shape)
    seen = np.isfinite(camera.bearings(noisy)).all(axis=1)
    return replace(
        map_,
        camera=camera,
        points=points,
        observation_keyframes=map_.observation_keyframes[seen],
        observation_landmarks=map_.observation_landmarks[seen],
        observation_pixels=noisy[seen],
    )


COLMAP_MODELS = {
    "rational": "FULL_OPENCV",
    "thin-prism": "PINHOLE",
    "fisheye": "OPENCV_FISHEYE",
    "thin-prism-fisheye": "THIN_PRISM_FISHEYE",
    "fov": "FOV",
    "omni": "PINHOLE",
    "double-sphere": "PINHOLE",
    "eucm": "EUCM",
    "equirectangular": "EQUIRECTANGULAR",
}


@pytest.mark.parametrize("model", LENSES)
def test_a_lens_is_written_by_its_model_or_as_an_undistorted_pinhole_and_a_note_says_so(tmp_path, model):
    if not hasattr(pycolmap.CameraModelId, COLMAP_MODELS[model]):
        pytest.skip(f"this pycolmap has no {COLMAP_MODELS[model]}")
    map_ = map_through(LENSES[model])
    read = read_by_colmap(tmp_path, map_)
    assert read.cameras[1].model.name == COLMAP_MODELS[model]
    note = colmap_note(LENSES[model])
    assert bool(note) == (COLMAP_MODELS[model] == "PINHOLE")
    assert note in (tmp_path / "colmap" / "cameras.txt").read_text()
    written_px = {i: point.error for i, point in read.points3D.items()}
    read.update_point_3d_errors()
    assert len(written_px) >= 40
    for i, point in read.points3D.items():
        np.testing.assert_allclose(point.xyz, map_.points[i - 1], rtol=1e-9)
        if model != "equirectangular":  # whose errors COLMAP measures as angles
            assert point.error == pytest.approx(written_px[i], abs=1e-6)
    for image in read.images.values():
        assert all(point.has_point3D() for point in image.points2D)


def test_a_part_of_a_panorama_and_a_bent_lens_have_no_model_of_colmap():
    part = replace(LENSES["equirectangular"], fx=200.0, fy=200.0)
    for camera in (part, LENSES["fov"].bent(0.1), LENSES["eucm"].bent(0.1)):
        assert "PINHOLE" in colmap_note(camera)
