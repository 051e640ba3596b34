"""Each export is opened by the reader of its tool, or read by the rules of its sources, and shows our map."""

import json
from dataclasses import replace
from functools import cache

import cv2
import msgpack
import numpy as np
import pycolmap
import pytest
import yaml
from make_lenses import LENSES
from make_map import CAMERAS, make_map
from make_source import GivenFrames
from written import contents

import slam_init
from quest.geometry.quaternion import rotation_from_vector
from slam_init.cli.main import main
from slam_init.errors import OutputError, SlamInitError
from slam_init.exports import check_formats
from slam_init.frontend.orb import orb_descriptors
from slam_init.output.names import EXPORTS, MCAP, STELLA
from slam_init.output.ros_messages import ros_covariance
from slam_init.output.scene import Undistortion, image_name
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose

ALL = tuple(EXPORTS)


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


def exported(folder, model="pinhole", formats=ALL):
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


def test_the_widest_pinhole_camera_touches_the_border_of_the_image_of_a_lens_and_a_wide_one_is_bounded():
    camera = CAMERAS["radtan"]
    scene = Undistortion.of(camera).camera
    wider = replace(scene, fx=0.99 * scene.fx, fy=0.99 * scene.fy)
    places = [camera.project(one.bearings(np.array([[0.0, 239.5], [639.0, 239.5], [320.0, 0.0], [320.0, 479.0]])))
              for one in (scene, wider)]  # fmt: skip
    limits = np.array([camera.width - 1, camera.height - 1])
    assert [bool(((found >= 0) & (found <= limits)).all()) for found in places] == [True, False]
    panorama = Undistortion.of(LENSES["equirectangular"]).camera
    assert np.degrees(np.arctan(np.hypot(640, 480) / 2 / panorama.fx)) == pytest.approx(60)


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


def test_a_panorama_for_stella_has_its_first_pixel_from_0_to_1(tmp_path):
    """Its model has the longitude 0 in the middle of the columns from 0 to the width."""
    camera = LENSES["equirectangular"]
    map_, rng = make_map(), np.random.default_rng(2)
    points = rng.normal(size=(60, 3)) * [1.0, 0.4, 1.0] + [0, 0, 6.0]
    seen = [camera.project(keyframe.world_from_cam.inverse().apply(points)) for keyframe in map_.keyframes]
    k, i = np.repeat(np.arange(len(seen)), len(points)), np.tile(np.arange(len(points)), len(seen))
    map_ = replace(
        map_, camera=camera, points=points, colors=np.zeros((60, 3), np.uint8), observation_keyframes=k,
        observation_landmarks=i, observation_pixels=np.concatenate(seen),
    )  # fmt: skip
    slam_init.export(map_, tmp_path, ("stella",), {one.frame: picture(camera) for one in map_.keyframes})
    content = msgpack.unpackb((tmp_path / STELLA).read_bytes())
    for one in content["keyframes"].values():
        x, y, z, w = one["rot_cw"]
        cam_from_world = Pose.from_quaternion(np.array([w, x, y, z]), np.array(one["trans_cw"]))
        rays = cam_from_world.apply(np.array([content["landmarks"][str(j)]["pos_w"] for j in one["lm_ids"]]))
        longitude, latitude = np.arctan2(rays[:, 0], rays[:, 2]), -np.arcsin(rays[:, 1] / np.linalg.norm(rays, axis=1))
        parts = np.column_stack([0.5 + longitude / (2 * np.pi), 0.5 - latitude / np.pi])
        pixels = [keypoint["pt"] for keypoint in one["undist_keypts"]]
        np.testing.assert_allclose(pixels, parts * [camera.width, camera.height], atol=1e-4)


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_a_map_for_stella_has_what_its_reader_asks_for_and_its_keypoints_see_the_points(tmp_path, model):
    """The rules of register_keyframe, register_landmark, register_graph and register_association of stella_vslam."""
    map_, _, images = exported(tmp_path / "out", model, ("stella",))
    content = msgpack.unpackb((tmp_path / "out" / STELLA).read_bytes())
    (camera_name, camera), *_ = content["cameras"].items()
    assert camera["model_type"] == ("Fisheye" if model == "fisheye" else "Perspective")
    assert {"setup_type", "color_order", "cols", "rows", "fps", "focal_x_baseline", "k1", "k2", "k3"} <= set(camera)
    assert list(content["keyframes"]) == ["0", "1", "2", "3"]
    assert content["keyframe_next_id"] == 4 and content["landmark_next_id"] > max(map(int, content["landmarks"]))
    K = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]])
    seen_by = {}
    for name, one in content["keyframes"].items():
        k, count = int(name), one["n_keypts"]
        assert one["cam"] == camera_name and one["orb_params"] in content["orb_params"]
        assert {len(one[key]) for key in ("undist_keypts", "descs", "lm_ids", "x_rights", "depths")} == {count}
        assert one["span_parent"] == k - 1 and one["span_children"] == ([k + 1] if k < 3 else [])
        x, y, z, w = one["rot_cw"]
        cam_from_world = Pose.from_quaternion(np.array([w, x, y, z]), np.array(one["trans_cw"]))
        points = np.array([content["landmarks"][str(i)]["pos_w"] for i in one["lm_ids"]])
        projected = cam_from_world.apply(points) @ K.T
        pixels = np.array([keypoint["pt"] for keypoint in one["undist_keypts"]])
        assert np.median(np.linalg.norm(projected[:, :2] / projected[:, 2:] - pixels, axis=1)) < 1.0
        for i in one["lm_ids"]:
            seen_by.setdefault(i, []).append(k)
        mine = map_.observation_keyframes == k
        found, known = orb_descriptors(images[map_.keyframes[k].frame], map_.observation_pixels[mine])
        row = dict(zip(map_.observation_landmarks[mine][known], found[known], strict=True))
        for i, words in zip(one["lm_ids"], one["descs"], strict=True):
            assert np.array(words, "<u4").tobytes() == row[i].tobytes()
    assert {str(i) for i in seen_by} == set(content["landmarks"])
    for i, landmark in content["landmarks"].items():
        assert landmark["1st_keyfrm"] == landmark["ref_keyfrm"] == min(seen_by[int(i)])
        assert landmark["n_vis"] == landmark["n_fnd"] == len(seen_by[int(i)]) >= 2


def test_a_reader_of_mcap_finds_transforms_poses_with_covariances_and_coloured_points(tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    map_, located, _ = exported(tmp_path / "out", formats=("mcap",))
    sent = {}
    for one in reader.read_ros2_messages(str(tmp_path / "out" / MCAP)):
        sent.setdefault(one.channel.topic, []).append(one)
    views = (*map_.keyframes, *located)
    assert set(sent) == {"/tf", "/tf_static", "/keyframes", "/path", "/points"}
    assert [len(sent[topic]) for topic in ("/tf", "/keyframes")] == [len(views), len(map_.keyframes)]

    def pose_of(message, place):
        q, t = message.rotation if hasattr(message, "rotation") else message.orientation, getattr(message, place)
        return Pose.from_quaternion(np.array([q.w, q.x, q.y, q.z]), np.array([t.x, t.y, t.z]))

    # Listeners of transforms ask for transient local; policies are numbers, as Humble reads no names.
    durability = {
        topic: [one["durability"] for one in yaml.safe_load(messages[0].channel.metadata["offered_qos_profiles"]) or ()]
        for topic, messages in sent.items()
    }
    assert durability == {"/tf": [], "/keyframes": [], "/tf_static": [1], "/path": [1], "/points": [1]}
    for one, view in zip(sent["/tf"], views, strict=True):
        (transform,) = one.ros_msg.transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "camera")
        stamp = transform.header.stamp
        assert one.log_time_ns == stamp.sec * 10**9 + stamp.nanosec == round(1e9 * view.timestamp_s)
        found = pose_of(transform.transform, "translation")
        np.testing.assert_allclose(found.matrix(), view.world_from_cam.matrix(), atol=1e-9)
    (static,) = sent["/tf_static"][0].ros_msg.transforms
    upright = pose_of(static.transform, "translation").R
    # Forward, left and up of the first camera are x, y and z.
    np.testing.assert_allclose(upright @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.eye(3), atol=1e-12)
    for one, view, covariance in zip(sent["/keyframes"], map_.keyframes, map_.pose_covariances, strict=True):
        message = one.ros_msg.pose
        np.testing.assert_allclose(pose_of(message.pose, "position").t, view.world_from_cam.t, atol=1e-12)
        np.testing.assert_allclose(
            np.reshape(message.covariance, (6, 6)), ros_covariance(view.world_from_cam, covariance), rtol=1e-12
        )
    assert len(sent["/path"][0].ros_msg.poses) == len(views)
    cloud = sent["/points"][0].ros_msg
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        ("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("rgb", 12, 7)
    ]  # fmt: skip
    data = np.frombuffer(bytes(cloud.data), [("xyz", "<f4", 3), ("rgb", "<u4")])
    np.testing.assert_allclose(data["xyz"], map_.points, rtol=1e-6)
    rgb = np.column_stack([data["rgb"] >> 16 & 255, data["rgb"] >> 8 & 255, data["rgb"] & 255])
    np.testing.assert_array_equal(rgb, map_.colors)


def test_a_covariance_in_ros_is_that_of_small_motions_in_the_axes_of_the_map():
    rng, step = np.random.default_rng(0), 1e-6
    pose = Pose(rotation_from_vector(np.array([0.7, -1.1, 0.4])), np.array([1.0, 2.0, -1.0]))
    root = rng.normal(0, 0.003, (6, 6))
    columns = []
    for w, v in (step * np.eye(6)).reshape(-1, 2, 3):
        turn = pose.R @ rotation_from_vector(w) @ pose.R.T  # in the axes of the map
        vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        columns.append(np.concatenate([pose.R @ v, vector]) / step)
    moved = np.array(columns).T @ root
    np.testing.assert_allclose(ros_covariance(pose, root @ root.T), moved @ moved.T, rtol=1e-6, atol=1e-12)


def test_the_same_map_gives_the_same_bytes_and_an_error_leaves_the_earlier_export(tmp_path):
    map_, located, images = exported(tmp_path / "a")
    exported(tmp_path / "b")
    first = contents(tmp_path / "a")
    assert first == contents(tmp_path / "b")
    assert {name.partition("/")[0] for name in first} == {"scene", STELLA, MCAP}
    del images[map_.keyframes[-1].frame]
    with pytest.raises(SlamInitError, match=f"frame {map_.keyframes[-1].frame}"):
        slam_init.export(map_, tmp_path / "a", ALL, images, located)
    assert contents(tmp_path / "a") == first
    slam_init.export(map_, tmp_path / "a", ("mcap",))  # the other files of the earlier export go
    assert set(contents(tmp_path / "a")) == {MCAP}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").touch()
    with pytest.raises(OutputError, match="not empty"):
        slam_init.export(map_, tmp_path / "mine", ("mcap",))


def test_a_run_exports_each_map_beside_its_files_from_the_frames_of_its_source(room_run, tmp_path):
    formats = ["scene", "mcap"]
    kept = replace(room_run.source)
    result, _ = slam_init.run(
        kept, kept.camera, out=tmp_path / "out", continue_frames=2, overview=False, export=formats
    )
    scene = tmp_path / "out" / "scene"
    frames = [*(one.frame for one in result.map.keyframes), *(result.map.keyframes[-1].frame + k for k in (1, 2))]
    assert sorted(path.name for path in (scene / "images").iterdir()) == [image_name(frame) for frame in frames]
    np.testing.assert_array_equal(
        cv2.imread(str(scene / "images" / image_name(frames[-1]))), kept.kept[frames[-1]].image
    )
    assert pycolmap.Reconstruction(scene / "sparse" / "0").compute_mean_reprojection_error() < 0.2
    assert (tmp_path / "out" / MCAP).is_file() and (tmp_path / "out" / "recording.rrd").is_file()
    assert not (tmp_path / "out" / STELLA).exists()


def test_pycolmap_has_the_map_in_memory():
    map_, located = map_with_covariances("fisheye")
    model = slam_init.pycolmap_reconstruction(map_, located)
    assert model.num_reg_images() == len(map_.keyframes) + 1
    assert model.cameras[1].model.name == "OPENCV_FISHEYE"
    assert model.compute_num_observations() == len(map_.observation_pixels)


@pytest.mark.parametrize(
    ("formats", "camera", "source", "message"),
    [
        (["obj"], None, None, "unknown format 'obj' of an export: use scene, stella, mcap"),
        (["stella"], LENSES["omni"], None, "no omni lens"),
        (["mcap", "scene"], None, GivenFrames(CAMERAS["pinhole"], (), kind="live"), "record it first"),
    ],
)
def test_an_export_that_cannot_be_made_is_refused_before_any_work(formats, camera, source, message):
    with pytest.raises(SlamInitError, match=message):
        check_formats(formats, camera, source)


def test_tracks_without_images_have_no_scene_and_the_command_says_what_to_do(tmp_path, capsys):
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 400, (80, 2))
    np.savez(tmp_path / "tracks.npz", frame=np.repeat([0, 1], 40), track=np.tile(np.arange(40), 2), xy=xy,
             size=np.array([640, 480]))  # fmt: skip
    assert main(["run", str(tmp_path / "tracks.npz"), "--out", str(tmp_path / "out"), "--export", "scene"]) == 2
    assert "needs images: name them by --images" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_image_of_another_size_is_refused(tmp_path):
    map_ = make_map()
    images = {one.frame: np.zeros((100, 100), np.uint8) for one in map_.keyframes}
    with pytest.raises(SlamInitError, match="is 100x100, but the camera is for 640x480"):
        slam_init.export(map_, tmp_path / "out", ("scene",), images)
