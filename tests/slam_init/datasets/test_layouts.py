"""The layouts of data sets: found by content, axes and calibration right, and broken files refused in one line."""

import json

import cv2
import make_layouts
import numpy as np
import pytest
from make_files import write
from make_layouts import FRAMES, LAYOUTS, POINT

from slam_init.datasets import detect_kind, open_source
from slam_init.datasets.posed_images import common_camera
from slam_init.errors import CalibrationError, SlamInitError, SourceError
from slam_init.types.camera import Camera


@pytest.fixture(params=sorted(LAYOUTS))
def layout(request):
    return LAYOUTS[request.param]


def test_a_known_point_of_the_world_lands_on_its_pixel(layout, tmp_path):
    folder = layout.make(tmp_path)
    assert detect_kind(folder) == layout.kind
    source = open_source(folder)
    frames = list(source.frames())
    assert (source.kind, len(source), len(frames)) == (layout.kind, FRAMES, FRAMES)
    for i, frame in enumerate(frames):
        pose = source.groundtruth.at(frame.timestamp_s, 1e-4)
        expected = make_layouts.spot(i, layout.focal, layout.centre)
        np.testing.assert_allclose(source.camera.project(pose.inverse().apply(POINT[None]))[0], expected, atol=1e-4)
        np.testing.assert_allclose(make_layouts.found_spot(frame.image), expected, atol=0.1)
    if layout.stamps_s:
        np.testing.assert_allclose(source.timestamps_s, layout.stamps_s, atol=1e-6)


def test_a_table_that_is_cut_off_or_no_table_is_refused_in_one_line(layout, tmp_path):
    folder = layout.make(tmp_path)
    for name in layout.tables:
        whole = (folder / name).read_bytes()
        # In the middle of a line of the first pose: shorter files may be a shorter sequence.
        for broken in (b"", b"\xff\xfe\x00", b"[1, 2", b"nan " * 40, whole[: len(whole) // 4 + 5]):
            (folder / name).write_bytes(broken)
            try:
                source = open_source(folder)
            except SlamInitError as error:
                assert len(str(error).splitlines()) == 1
                assert (folder / name).name in str(error) or str(folder) in str(error)
            else:  # what could not be read is not made up
                assert source.groundtruth is None or len(source.groundtruth.timestamps_s) < FRAMES or broken == b""
        (folder / name).write_bytes(whole)
    assert len(open_source(folder)) == FRAMES


def test_the_frames_of_a_video_have_the_times_and_poses_that_are_stated_beside_it(tmp_path):
    folder = make_layouts.stray_scanner(tmp_path)
    writer = cv2.VideoWriter(str(folder / "rgb.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (64, 48))
    for path in sorted((folder / "rgb").iterdir()):
        writer.write(cv2.imread(str(path)))
    writer.release()
    source = open_source(folder)
    frames = list(source.frames(1))
    np.testing.assert_allclose([frame.timestamp_s for frame in frames], [5 + 1 / 60, 5 + 2 / 60])
    for frame in frames:
        np.testing.assert_allclose(make_layouts.found_spot(frame.gray), make_layouts.spot(frame.index), atol=0.5)
    assert source.groundtruth.at(5 + 2 / 60, 1e-6) is not None
    write(folder / "odometry.csv", "\n".join((folder / "odometry.csv").read_text().splitlines()[:-1]))
    shorter = open_source(folder)
    assert (len(shorter), len(list(shorter.frames()))) == (FRAMES - 1, FRAMES - 1)
    assert "2 poses for 3 frames" in shorter.notes[0]
    (folder / "rgb.mp4").unlink()
    (folder / "rgb.mp4").symlink_to("/etc/hostname")
    with pytest.raises(SourceError, match="leads out of the folder"):
        open_source(folder)


def test_images_that_a_list_names_elsewhere_are_not_read(tmp_path):
    outside = tmp_path / "outside.png"
    make_layouts.write_spot(outside, 0)
    for make, name in ((make_layouts.transforms, "transforms.json"), (make_layouts.colmap_text, "sparse/0/images.txt")):
        folder = make(tmp_path / name.replace("/", "-"))
        content = (folder / name).read_text()
        first = "./images/frame_1.png" if name.endswith("json") else "view 0.png"
        write(folder / name, content.replace(first, str(outside)))
        with pytest.raises(SourceError, match="leads out of the folder"):
            list(open_source(folder).frames())


def test_images_that_are_not_in_the_folder_are_left_out_and_told(tmp_path):
    source = open_source(make_layouts.transforms(tmp_path))
    assert source.notes == ("1 of 4 listed images are not in the folder",)
    (tmp_path / "images").rename(tmp_path / "pictures")
    with pytest.raises(SourceError, match="holds none of the 4 images"):
        open_source(tmp_path)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "not supported"),
        ({"fl_x": "wide"}, "fl_x is 'wide'"),
        ({"fl_x": -5}, "focal length"),
        ({"w": 64.5}, "whole pixels"),
        ({"k4": 0.1}, "k4 is not supported"),
        ({"frames": []}, "frames is missing or empty"),
        ({"frames": [{"file_path": 3}]}, "frame 0: file_path"),
        ({"frames": [{"file_path": "images/frame_1.png", "transform_matrix": [[1, 2], [3]]}]}, "not an array"),
        ({"frames": [{"file_path": "images/frame_1.png", "transform_matrix": np.zeros((4, 4)).tolist()}]}, "rotation"),
    ],
)
def test_an_impossible_value_of_transforms_is_named(tmp_path, change, word):
    folder = make_layouts.transforms(tmp_path)
    content = json.loads((folder / "transforms.json").read_text())
    write(folder / "transforms.json", json.dumps(content | change))
    with pytest.raises(SlamInitError, match=word) as caught:
        open_source(folder)
    assert "transforms.json" in str(caught.value)


def test_json_that_is_nested_too_deeply_is_refused(tmp_path):
    write(tmp_path / "transforms.json", '{"frames": ' + "[" * 100_000)
    with pytest.raises(SourceError, match=r"transforms.json"):
        open_source(tmp_path)


@pytest.mark.parametrize(
    "header", ["{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 17), }", "{'descr'"]
)
def test_an_array_that_states_more_than_its_file_holds_is_refused_before_it_is_allocated(tmp_path, header):
    make_layouts.llff(tmp_path)
    text = header.ljust(117) + "\n"
    write(tmp_path / "poses_bounds.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode())
    with pytest.raises(SourceError, match="cut off"):
        open_source(tmp_path)


def test_a_pickle_in_an_array_is_not_loaded(tmp_path):
    make_layouts.llff(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(SourceError, match="expected numbers"):
        open_source(tmp_path)


def test_the_truth_of_another_body_is_not_used_without_its_calibration(tmp_path):
    folder = make_layouts.uzh_fpv(tmp_path)
    next(tmp_path.glob("*calib*/*.yaml")).unlink()
    source = open_source(folder)
    assert source.groundtruth is None
    assert source.camera is None
    assert "camchain" in source.notes[0]


def test_a_colmap_model_with_a_camera_that_is_not_supported_says_which(tmp_path):
    folder = make_layouts.colmap_text(tmp_path)
    write(folder / "sparse" / "0" / "cameras.txt", "3 SIMPLE_UNKNOWN 64 48 60 32 24\n")
    with pytest.raises(CalibrationError, match=r"cameras.txt:1"):
        open_source(folder)


def test_images_of_one_camera_that_focuses_get_the_median_calibration():
    cameras = [Camera("pinhole", 640, 480, 500 + df, 500 + df, 320, 240) for df in (0, 1, 2)]
    camera, kept, notes = common_camera(cameras, "x")
    assert (camera.fx, kept) == (501, [True] * 3)
    assert "differ by up to 0.8 px" in notes[0]


def test_images_of_another_camera_are_left_out_and_told():
    wide, tele = (Camera("pinhole", 640, 480, f, f, 320, 240) for f in (400, 800))
    camera, kept, notes = common_camera([wide, wide, tele, wide, None], "x")
    assert (camera, kept) == (wide, [True, True, False, True, False])
    assert notes == ("2 of 5 images are of another camera, and are left out",)
    with pytest.raises(CalibrationError, match="different cameras"):
        common_camera([wide, tele], "x")
