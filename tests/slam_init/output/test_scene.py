"""Each export is opened by the reader of its tool, or read by the rules of its sources, and shows our map."""

import json
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pycolmap
import pytest
from make_lenses import LENSES
from make_map import CAMERAS, make_map
from make_source import GivenFrames
from written import contents

import slam_init
from slam_init.cli.main import main
from slam_init.errors import OutputError, SlamInitError
from slam_init.output.scene import Undistortion, check_formats, image_name, transforms_text
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose


def shade(rays):
    """A smooth brightness of each direction, so that images of different lenses can be compared."""
    x, y, z = rays.T / np.linalg.norm(rays, axis=1)
    return 128 + 60 * np.sin(6 * x + 1) * np.cos(5 * y) + 40 * np.sin(4 * x * y + z)


@cache
def picture(camera):
    """The image of these directions; pixels without a ray are black."""
    y, x = np.mgrid[: camera.height, : camera.width]
    rays = camera.bearings(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    return np.round(np.nan_to_num(shade(rays))).astype(np.uint8).reshape(y.shape)


def map_with_covariances(model="pinhole"):
    """The map of other tests, with a frame that was located after it."""
    map_, rng = make_map(model), np.random.default_rng(5)
    roots = rng.normal(0, 0.01, (len(map_.keyframes), 6, 6))
    map_ = replace(map_, pose_covariances=roots @ roots.transpose(0, 2, 1))
    last = map_.keyframes[-1]
    pose = Pose(last.world_from_cam.R, last.world_from_cam.t + np.array([0.1, 0, 0]))
    return map_, (Keyframe(last.frame + 3, last.timestamp_s + 0.1, "rgb/later.png", pose),)


def exported(folder, model="pinhole", formats=("scene",)):
    map_, located = map_with_covariances(model)
    images = {one.frame: picture(CAMERAS[model]) for one in (*map_.keyframes, *located)}
    slam_init.export(map_, folder, formats, images, located)
    return map_, located, images


@pytest.mark.parametrize("camera", [*CAMERAS.values(), *LENSES.values()], ids=[*CAMERAS, *LENSES])
def test_an_undistorted_image_shows_in_each_pixel_what_the_ray_of_a_centred_pinhole_sees(camera):
    undistortion = Undistortion.of(camera)
    scene = undistortion.camera
    assert scene.model == "pinhole"
    assert abs(scene.cx - (scene.width - 1) / 2) <= 0.25 + 1e-9
    assert abs(scene.cy - (scene.height - 1) / 2) <= 0.25 + 1e-9
    image = undistortion.image(picture(camera))
    assert image.shape == (scene.height, scene.width, 3)
    difference = np.abs(image[..., 0].astype(float) - picture(scene))
    # Cubic interpolation of whole grey values: none of a black pixel, which would be 100 off.
    assert difference.mean() < 0.6 and difference.max() < 3


@pytest.mark.parametrize("model", CAMERAS)
def test_colmap_opens_the_scene_and_finds_the_errors_that_are_written_in_it(tmp_path, model):
    map_, located, _ = exported(tmp_path / "out", model, ("scene",))
    scene = tmp_path / "out" / "scene"
    read = pycolmap.Reconstruction(scene / "sparse" / "0")
    (camera,) = read.cameras.values()
    assert camera.model.name == "PINHOLE"
    names = [image_name(one.frame) for one in (*map_.keyframes, *located)]
    assert [read.images[k + 1].name for k in range(len(names))] == names
    for name in names:
        assert cv2.imread(str(scene / "images" / name)).shape == (camera.height, camera.width, 3)
    assert read.images[len(names)].num_points3D == 0
    for k, one in enumerate((*map_.keyframes, *located), start=1):
        matrix = read.images[k].cam_from_world().matrix()
        np.testing.assert_allclose(matrix, one.world_from_cam.inverse().matrix()[:3], atol=1e-12)
    written_px = {i: point.error for i, point in read.points3D.items()}
    read.update_point_3d_errors()
    assert len(written_px) > 0.9 * len(map_.points)
    for i, point in read.points3D.items():
        assert point.error == pytest.approx(written_px[i], abs=1e-9) and point.error < 2
        np.testing.assert_array_equal(point.xyz, map_.points[i - 1])
        np.testing.assert_array_equal(point.color, map_.colors[i - 1])
        assert {e.image_id for e in point.track.elements} <= set(map_.observation_keyframes[
            map_.observation_landmarks == i - 1] + 1)  # fmt: skip


def test_transforms_json_and_its_points_say_the_same_as_the_colmap_model(tmp_path):
    """nerfstudio's rules: axes of OpenGL, files beside the JSON, points in the world of the cameras."""
    exported(tmp_path / "out", "fisheye", ("scene",))
    scene = tmp_path / "out" / "scene"
    read = pycolmap.Reconstruction(scene / "sparse" / "0")
    content = json.loads((scene / "transforms.json").read_text())
    camera = read.cameras[1]
    assert content["camera_model"] == "OPENCV" and not {"k1", "k2", "p1", "p2"} & set(content)
    assert (content["w"], content["h"]) == (camera.width, camera.height)
    intrinsics = [content[name] for name in ("fl_x", "fl_y", "cx", "cy")]
    np.testing.assert_allclose(intrinsics, camera.params)
    header, _, body = (scene / content["ply_file_path"]).read_bytes().partition(b"end_header\n")
    assert b"element vertex %d\n" % len(read.points3D) in header
    points = np.frombuffer(body, [("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])["xyz"].astype(float)
    np.testing.assert_allclose(points, [read.points3D[i].xyz for i in sorted(read.points3D)], rtol=1e-6)
    assert len(content["frames"]) == len(read.images)
    for frame in content["frames"]:
        assert (scene / frame["file_path"]).is_file()
        matrix = np.linalg.inv(frame["transform_matrix"])
        x, y, z = (points @ matrix[:3, :3].T + matrix[:3, 3]).T
        image = next(one for one in read.images.values() if f"images/{one.name}" == frame["file_path"])
        ours = np.column_stack([content["cx"] - content["fl_x"] * x / z, content["cy"] + content["fl_y"] * y / z])
        theirs = [image.project_point(point) for point in points]
        np.testing.assert_allclose(ours, np.array(theirs), atol=1e-6)


def test_points_that_gaussian_splatting_has_left_in_a_scene_are_replaced(tmp_path):
    """Its loader writes sparse/0/points3D.ply from points3D.bin, and prefers it from then on."""
    exported(tmp_path / "out", "fisheye", ("scene",))
    points = tmp_path / "out" / "scene" / "sparse" / "0" / "points3D.ply"
    points.write_bytes(b"of an earlier map")
    exported(tmp_path / "out", "pinhole", ("scene",))
    assert points.read_bytes() == (tmp_path / "out" / "scene" / "points.ply").read_bytes()


def test_the_same_map_gives_the_same_bytes_and_an_error_leaves_the_earlier_export(tmp_path):
    map_, located, images = exported(tmp_path / "a")
    exported(tmp_path / "b")
    first = contents(tmp_path / "a")
    assert first == contents(tmp_path / "b")
    assert {name.partition("/")[0] for name in first} == {"scene"}
    del images[map_.keyframes[-1].frame]
    with pytest.raises(SlamInitError, match=f"frame {map_.keyframes[-1].frame}"):
        slam_init.export(map_, tmp_path / "a", ("scene",), images, located)
    assert contents(tmp_path / "a") == first
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").touch()
    with pytest.raises(OutputError, match="not empty"):
        exported(tmp_path / "mine")


def test_a_run_exports_each_map_beside_its_files_from_the_frames_of_its_source(room_run, tmp_path):
    kept = replace(room_run.source)
    result, _ = slam_init.run(
        kept, kept.camera, out=tmp_path / "out", continue_frames=2, overview=False, export=["scene"]
    )
    scene = tmp_path / "out" / "scene"
    frames = [*(one.frame for one in result.map.keyframes), *(result.map.keyframes[-1].frame + k for k in (1, 2))]
    assert sorted(path.name for path in (scene / "images").iterdir()) == [image_name(frame) for frame in frames]
    np.testing.assert_array_equal(
        cv2.imread(str(scene / "images" / image_name(frames[-1]))), kept.kept[frames[-1]].image
    )
    assert pycolmap.Reconstruction(scene / "sparse" / "0").compute_mean_reprojection_error() < 0.2
    assert (tmp_path / "out" / "recording.rrd").is_file()


def test_an_export_that_cannot_be_made_is_refused_before_any_work():
    with pytest.raises(SlamInitError, match="unknown format 'obj' of an export: use scene"):
        check_formats(["obj"])
    with pytest.raises(SlamInitError, match="record it first"):
        check_formats(["scene"], GivenFrames(CAMERAS["pinhole"], (), kind="live"))


def test_tracks_without_images_have_no_scene_and_the_command_says_what_to_do(tmp_path, capsys):
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 400, (80, 2))
    np.savez(tmp_path / "tracks.npz", frame=np.repeat([0, 1], 40), track=np.tile(np.arange(40), 2), xy=xy,
             size=np.array([640, 480]))  # fmt: skip
    assert main(["run", str(tmp_path / "tracks.npz"), "--out", str(tmp_path / "out"), "--export", "scene"]) == 2
    assert "needs images: name them by --images" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# -- the cameras for nerfstudio --------------------------------------------------------------------


def test_in_the_axes_of_opengl_the_scene_lies_at_negative_z_and_up_is_positive():
    map_ = make_map()
    (frame, *_) = json.loads(transforms_text(map_))["frames"]
    matrix = np.linalg.inv(frame["transform_matrix"])
    seen = map_.points @ matrix[:3, :3].T + matrix[:3, 3]
    ours = map_.keyframes[0].world_from_cam.inverse().apply(map_.points)
    np.testing.assert_allclose(seen, ours * [1, -1, -1], atol=1e-12)
    assert (seen[:, 2] < 0).all()


@pytest.mark.parametrize("model", CAMERAS)
def test_the_intrinsics_have_nerfstudios_names_and_pixel_centres(model):
    content, camera = json.loads(transforms_text(make_map(model))), CAMERAS[model]
    assert content["camera_model"] == ("OPENCV_FISHEYE" if model == "fisheye" else "OPENCV")
    # instant-ngp reads no camera_model.
    assert content.get("is_fisheye", False) == (model == "fisheye")
    assert (content["fl_x"], content["fl_y"], content["w"], content["h"]) == (camera.fx, camera.fy, 640, 480)
    assert (content["cx"], content["cy"]) == (camera.cx + 0.5, camera.cy + 0.5)
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    assert [content.get(name, 0.0) for name in names[: len(camera.distortion)]] == list(camera.distortion)
    assert content["ply_file_path"] == "map.ply"
