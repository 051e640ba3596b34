"""Maps of other programs: what their files state is what the map has, and a pose belongs to one image."""

import json
from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from make_files import picture, write, write_image
from make_map import make_map

from slam_init import Camera, Pose, SourceError, open_source
from slam_init.config import Config
from slam_init.datasets.map_files import open_map, tracked_by
from slam_init.output.scene import opengl_matrix

COUNT = 12


@pytest.fixture
def sequence(tmp_path):
    """The images of a sequence at 100 Hz as in TUM's format, with names that are numbers."""
    for k in range(COUNT):
        write_image(tmp_path / "rgb" / f"{k:04d}.png", picture(k, channels=1))
    stamps = [f"{1.7e9 + 0.01 * k:.6f}" for k in range(COUNT)]
    write(tmp_path / "rgb.txt", "".join(f"{stamp} rgb/{k:04d}.png\n" for k, stamp in enumerate(stamps)))
    return SimpleNamespace(folder=tmp_path, stamps=stamps)


def poses_in(map_, sequence):
    camera = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)
    return tracked_by(map_, open_source(sequence.folder), camera, Config())[0]


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_a_graph_of_gtsam_states_what_the_handover_states(model, tmp_path):
    made = make_map(model)
    made.save(tmp_path / "run")
    of_graph, of_arrays = open_map(tmp_path / "run" / "graph.txt"), open_map(tmp_path / "run")
    assert of_graph.frames == of_arrays.frames
    of = [(one.fx, one.fy, one.cx, one.cy, *one.distortion) for one in (of_graph.camera, of_arrays.camera)]
    assert of_graph.camera.model == of_arrays.camera.model and of[0] == pytest.approx(of[1])
    for one, other in zip(of_graph.tracks(made.camera), of_arrays.tracks(made.camera), strict=True):
        assert one.frame == other.frame
        # The landmark of a graph is named by its key.
        rows = np.argsort(one.track_ids), np.argsort(other.track_ids)
        np.testing.assert_allclose(one.pixels[rows[0]], other.pixels[rows[1]], atol=1e-6)


def test_a_colmap_model_of_a_video_belongs_to_its_frames(tmp_path):
    """A video has no names of files: a model that a run of it wrote names its frames by their numbers."""
    made = make_map()
    named = [replace(keyframe, name=f"frame-{keyframe.frame:06d}") for keyframe in made.keyframes]
    replace(made, keyframes=tuple(named)).save(tmp_path)
    poses, *_ = tracked_by(open_map(tmp_path / "colmap"), open_source("synth:room"), made.camera, Config())
    assert sorted(poses) == [keyframe.frame for keyframe in named]


def graph_of(folder, *factors, values):
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    write(folder / "graph.txt", graph.serialize())
    write(folder / "values.txt", values.serialize())
    return folder


def observation(frame, calibration, *body_from_cam, name="x"):
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    keys = gtsam.symbol(name, frame), gtsam.symbol("l", 0)
    return gtsam.GenericProjectionFactorCal3_S2(np.ones(2), noise, *keys, calibration, False, False, *body_from_cam)


def test_a_graph_with_points_anywhere_is_read(tmp_path):
    """Points behind a camera have no projection."""
    for depth in (3.0, 0.0, -3.0):
        values = gtsam.Values()
        values.insert(gtsam.symbol("x", 0), gtsam.Pose3())
        values.insert(gtsam.symbol("l", 0), np.array([0.1, 0.2, depth]))
        assert open_map(graph_of(tmp_path / f"{depth}", observation(0, CAL), values=values)).frames == (0,)


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        (list, "no projection factor"),
        (lambda: [observation(0, gtsam.Cal3_S2(50, 50, 1, 32, 24))], "skew"),
        (lambda: [observation(k, gtsam.Cal3_S2(50 + k, 50, 0, 32, 24)) for k in (0, 1)], "2 calibrations"),
        (lambda: [observation(0, CAL), observation(0, CAL, name="y")], "two poses"),
        (lambda: [observation(2, CAL)], 'the key "x2"'),
        (lambda: [observation(0, CAL, gtsam.Pose3(gtsam.Rot3(), np.array([0.1, 0, 0])))], "sit on a body"),
    ],
)
def test_a_graph_that_is_no_map_of_one_camera_is_reported_in_one_line(factors, said, tmp_path):
    values = gtsam.Values()
    for key in (gtsam.symbol("x", 0), gtsam.symbol("x", 1), gtsam.symbol("y", 0)):
        values.insert(key, gtsam.Pose3())
    values.insert(gtsam.symbol("l", 0), np.array([0.1, 0.2, 3.0]))
    with pytest.raises(SourceError, match=said):
        open_map(graph_of(tmp_path / "graph", *factors(), values=values))


CAL = gtsam.Cal3_S2(50, 50, 0, 32, 24)


@pytest.mark.parametrize("unit", [1.0, 1e9])
def test_a_keyframe_belongs_to_one_image(unit, sequence):
    """ORB-SLAM writes the keyframes of TUM's sequences in seconds, and those of EuRoC in nanoseconds."""
    lines = [f"{float(sequence.stamps[k]) * unit:.7f} {k} 0 0 0 0 0 1\n" for k in (2, 7)]
    path = write(sequence.folder / "KeyFrameTrajectory.txt", "".join(lines))
    found = poses_in(open_map(path), sequence)
    assert {frame: pose.t[0] for frame, pose in found.items()} == {2: 2, 7: 7}


def rows_of(form, stamps, poses):
    """The lines of a trajectory in a form; each pose is world_from_cam."""
    for k, (stamp, pose) in enumerate(zip(stamps, poses, strict=True)):
        (w, x, y, z), t, matrix = pose.q_wxyz, pose.t, pose.matrix()
        yield form(k, float(stamp), [*t], [x, y, z, w], [w, x, y, z], [*matrix[:3].ravel()], [*matrix.ravel()])


EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x"
)
ROS = "%time;field.header.frame_id;" + ";".join(
    [f"field.pose.orientation.{axis}" for axis in "wxyz"] + [f"field.pose.position.{axis}" for axis in "xyz"]
)
#: The header, the separator, and the numbers of a line.
FORMS = {
    "TUM": ("# a comment", " ", lambda k, s, t, xyzw, *_: [s, *t, *xyzw]),
    "names": ("stamp tx ty tz q_w q_x q_y q_z", "\t", lambda k, s, t, xyzw, wxyz, *_: [s, *t, *wxyz]),
    "EuRoC": (EUROC, ", ", lambda k, s, t, xyzw, wxyz, *_: [1e9 * s, *t, *wxyz, 7]),
    "ROS": (ROS, ";", lambda k, s, t, xyzw, wxyz, *_: [1e9 * s, "map", *wxyz, *t]),
    "matrix": ("", " ", lambda k, s, t, xyzw, wxyz, matrix, square: matrix),
    "square matrix": ("", " ", lambda k, s, t, xyzw, wxyz, matrix, square: [s, *square]),
    "equal stamps": ("", " ", lambda k, s, t, xyzw, *_: [3.5, *t, *xyzw]),
    "seven numbers": ("", ",", lambda k, s, t, xyzw, *_: [*t, *xyzw]),
    "no stamps": ("# tx ty tz qx qy qz qw", " ", lambda k, s, t, xyzw, *_: [*t, *xyzw]),
    "another clock": ("", " ", lambda k, s, t, xyzw, *_: [s - 1.6e9, *t, *xyzw]),
    "a late clock": ("", " ", lambda k, s, t, xyzw, *_: [s + 0.05, *t, *xyzw]),
    "numbers": ("", " ", lambda k, s, t, xyzw, *_: [k, *t, *xyzw]),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_trajectory_is_the_same_in_all_forms(name, sequence):
    header, separator, form = FORMS[name]
    rng = np.random.default_rng(1)
    poses = [Pose.from_quaternion(rng.normal(size=4), rng.normal(size=3)) for _ in range(COUNT)]
    lines = [separator.join(map(str, row)) for row in rows_of(form, sequence.stamps, poses)]
    path = write(sequence.folder / "poses.txt", "\n".join([header, *lines]))
    found = poses_in(open_map(path), sequence)
    assert sorted(found) == list(range(COUNT))
    for frame, pose in found.items():
        np.testing.assert_allclose(pose.matrix(), poses[frame].matrix(), atol=1e-9)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{k} 0 0 0 1 1 0 1", "name the columns"),
        ("1 0 0 0 0 1 0 0 0 0 1 0", "5 poses without times for 12 images"),
        ("{k}.5 0 0 0 0 0 0 1", "time stamps of 0.5 to 4.5, and images of 1700000000 to 1700000000.11"),
        ("# tx ty tz qx qy qz qw\n{k} 0 0 0 0 0 0 1", "has 8 columns, and the header names 7"),
    ],
)
def test_a_trajectory_of_unknown_form_is_reported_in_one_line(line, said, sequence):
    path = write(sequence.folder / "poses.txt", "".join(line.format(k=k) + "\n" for k in range(5)))
    with pytest.raises(SourceError, match=said):
        poses_in(open_map(path), sequence)


def transforms(folder, names):
    frames = [
        {"file_path": name, "transform_matrix": opengl_matrix(Pose(np.eye(3), np.array([k, 0.0, 0.0]))).tolist()}
        for k, name in enumerate(names)
    ]
    content = {"fl_x": 60.0, "w": 64, "h": 48, "cx": 32, "cy": 24, "frames": frames}
    return write(folder / "transforms.json", json.dumps(content))


@pytest.mark.parametrize("root", ["images", "/elsewhere", "../above"])
def test_the_images_of_nerfstudio_are_found_by_the_ends_of_their_names(root, sequence, tmp_path):
    path = transforms(tmp_path / "other", [f"{root}/0003.png", f"{root}/rgb/0009.png", f"{root}/absent.png"])
    map_ = open_map(path)
    assert map_.camera.fx == 60 and map_.images == path.parent
    assert {frame: pose.t[0] for frame, pose in poses_in(map_, sequence).items()} == {3: 0, 9: 1}
    np.testing.assert_allclose(map_.world_from_cam[0].R, np.eye(3), atol=1e-12)
