"""The layouts of data sets: found by content, axes and calibration right, and broken files refused in one line."""

import json
from types import SimpleNamespace

import make_layouts
import numpy as np
import pytest
from add_a_data_set import LAYOUT
from make_files import picture, write, write_image
from make_layouts import FRAMES, LAYOUTS, POINT

from slam_init.datasets import detect_kind, layouts, open_source, opening
from slam_init.datasets.layouts import read_transforms
from slam_init.datasets.posed_images import common_camera
from slam_init.errors import CalibrationError, SlamInitError, SourceError
from slam_init.types.camera import Camera


@pytest.fixture(params=sorted(LAYOUTS))
def layout(request):
    return LAYOUTS[request.param]


def test_every_layout_has_a_sample():
    assert {layout.kind for layout in LAYOUTS.values()} == {layout.kind for layout in layouts.LAYOUTS}


def test_a_known_point_of_the_world_lands_on_its_pixel(layout, tmp_path):
    folder = layout.make(tmp_path)
    assert detect_kind(folder) == layout.kind
    source = open_source(folder)
    frames = list(source.frames())
    assert (source.kind, len(source), len(frames)) == (layout.kind, FRAMES, FRAMES)
    assert (source.camera.source == "machine") == (layout.kind in ("euroc", "kitti", "tartanair"))
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
                assert (folder / name).name in str(error) or str(folder) in str(error)
            else:  # what could not be read is not made up
                assert source.groundtruth is None or len(source.groundtruth.timestamps_s) < FRAMES or broken == b""
        (folder / name).write_bytes(whole)
    assert len(open_source(folder)) == FRAMES


@pytest.mark.parametrize(
    ("name", "file", "text", "word"),
    [
        ("euroc", "mav0/cam0/data.csv", "#t\n12x,a.png\n", r"data\.csv:2"),
        ("kitti", "../times.txt", "0\n", "1 times for 3 images"),
        ("kitti", "../times.txt", "0\nx\n", "times.txt:2"),
        ("kitti", "../calib.txt", "P1: 1\n", "no line P2"),
        ("kitti", "../calib.txt", "P2: 1 2 3\n", "calib.txt:1"),
        ("kitti", "../calib.txt", "P2: 0 0 0 0 0 0 0 0 0 0 1 0\n", "focal"),
        ("kitti", "../../../poses/06.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 3 images"),
        ("kitti", "../../../poses/06.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n", "not a rotation"),
        ("eth3d", "rgb.txt", "0 rgb/0.png\nx rgb/1.png\n", "rgb.txt:2"),
        ("eth3d", "rgb.txt", "0 rgb/0.png\n1\n", "rgb.txt:2"),
        ("eth3d", "rgb.txt", "# nothing\n", "lists no image"),
        ("eth3d", "rgb.txt", b"\xff\xfe\x00\x80", "rgb.txt"),
        ("eth3d", "groundtruth.txt", "# t\n0 1 2 3\n", "groundtruth.txt:2"),
        ("eth3d", "groundtruth.txt", "0 0 0 0 0 0 0 0\n", "groundtruth.txt:1"),
        ("eth3d", "groundtruth.txt", "0 0 0 inf 0 0 0 1\n", "groundtruth.txt:1"),
        ("eth3d", "groundtruth.txt", "0 0 0 0 0 0 0 1\n1 1e300 0 0 0 0 0 1\n", "txt:2: the position .* is no place on"),
    ],
)
def test_a_broken_line_is_refused_with_file_and_line(tmp_path, name, file, text, word):
    folder = LAYOUTS[name].make(tmp_path)
    write(folder / file, text)
    with pytest.raises(SlamInitError, match=word):
        open_source(folder)


@pytest.mark.parametrize(
    "text",
    ["\ufeff0 rgb/0.png\n1 rgb/1.png\n2 rgb/2.png", "0 rgb/0.png\r\n1 rgb/1.png  \r\n\r\n# end\r\n2\trgb/2.png\r\n"],
)
def test_text_files_may_have_a_byte_order_mark_crlf_blank_lines_and_comments(tmp_path, text):
    write(make_layouts.eth3d(tmp_path) / "rgb.txt", text)
    assert [frame.name for frame in open_source(tmp_path).frames()] == ["0.png", "1.png", "2.png"]


@pytest.mark.parametrize("sub", ["", "mav0", "mav0/cam0"])
def test_each_folder_of_a_euroc_sequence_opens_the_whole(tmp_path, sub):
    source = open_source(make_layouts.euroc(tmp_path) / sub)
    assert (source.name, len(source), source.groundtruth is not None) == ("MH_01", FRAMES, True)
    assert source.timestamps_s[0] == 1403636579.763555584


def test_the_images_of_a_kitti_sequence_are_those_of_its_first_camera_and_its_poses_may_lie_beside_them(tmp_path):
    sequence = make_layouts.kitti(tmp_path).parent
    (tmp_path / "dataset" / "poses" / "06.txt").rename(sequence / "poses.txt")
    (sequence / "image_2").rename(sequence / "image_0")
    source = open_source(sequence)
    assert source.name == "06/image_0"
    T = make_layouts.pose(0)
    np.testing.assert_allclose(source.groundtruth.at(0.0).t, T[:3, 3] - 0.6 * T[:3, 0], atol=1e-12)


def test_images_behind_a_link_are_read_only_where_the_user_names_the_link(tmp_path):
    images = make_layouts.kitti(tmp_path)
    moved = tmp_path / "elsewhere" / "image_2"
    moved.parent.mkdir()
    images.rename(moved)
    images.symlink_to(moved)
    with pytest.raises(SourceError, match=r"image_2: leads out of the folder"):
        open_source(images.parent)
    write(moved.parent / "times.txt", "0\n0.1\n0.2\n")
    assert len(list(open_source(images).frames())) == FRAMES


def test_file_names_in_rgb_txt_may_hold_spaces_and_a_missing_file_is_named(tmp_path):
    folder = make_layouts.eth3d(tmp_path)
    (folder / "rgb" / "0.png").rename(folder / "rgb" / "a b.png")
    write(folder / "rgb.txt", "0 rgb/a b.png\n1 rgb/c.png\n")
    frames = open_source(folder).frames()
    assert next(frames).name == "a b.png"
    with pytest.raises(SourceError, match=r"c\.png"):
        next(frames)


def test_known_kinects_are_recognized_by_the_name_of_the_folder(tmp_path):
    folder = make_layouts.eth3d(tmp_path / "rgbd_dataset_freiburg2_desk")
    (folder / "calibration.txt").unlink()
    assert open_source(folder).camera.fx == 520.908620


def test_associations_have_colour_and_depth_in_either_order(tmp_path):
    folder = make_layouts.eth3d(tmp_path)
    (folder / "rgb.txt").unlink()
    for line in ("10.0 rgb/1.png 10.01 depth/1.png\n", "10.01 depth/1.png 10.0 rgb/1.png\n"):
        write(folder / "associations.txt", line)
        source = open_source(folder)
        assert (source.paths[0].parent.name, source.timestamps_s.tolist()) == ("rgb", [10.0])


def test_icl_nuim_poses_are_reflected_to_fit_the_images(tmp_path):
    """A camera that turns right and moves up in ICL-NUIM's frame (y up) must do so here (y down)."""
    for i in range(2):
        write_image(tmp_path / "rgb" / f"{i}.png", picture(i, (640, 480)))
    write(tmp_path / "associations.txt", "0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n")
    angle = 0.2
    turned = f"1 0 0.3 0 0 {np.sin(angle / 2)} 0 {np.cos(angle / 2)}\n"
    write(tmp_path / "livingRoom0.gt.freiburg", f"0 0 0 0 0 0 0 1\n{turned}")
    source = open_source(tmp_path)
    assert source.camera == Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30])
    pose = source.groundtruth.at(1 / 30)
    assert pose.t.tolist() == [0, -0.3, 0]  # y points down: up is negative
    # The reflection keeps z forward and x right, so that the optical axis turns towards +x in both frames.
    np.testing.assert_allclose(pose.R[:, 2], [np.sin(angle), 0, np.cos(angle)], atol=1e-12)
    assert np.linalg.det(pose.R) == pytest.approx(1)


def test_an_image_folder_is_read_in_natural_order(tmp_path):
    for name in ("img10.png", "img2.png", "img1.jpg", ".hidden.png"):
        write_image(tmp_path / name)
    write(tmp_path / "notes.txt", "no image")
    source = open_source(tmp_path)
    assert source.kind == "images" and source.camera is None and source.groundtruth is None
    assert [frame.name for frame in source.frames()] == ["img1.jpg", "img2.png", "img10.png"]
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30, 2 / 30])


@pytest.mark.parametrize(
    ("name", "file", "first"),
    [
        ("transforms", "transforms.json", "./images/frame_1.png"),
        ("colmap-text", "sparse/0/images.txt", "view 0.png"),
        ("eth3d", "rgb.txt", "rgb/0.png"),
    ],
)
@pytest.mark.parametrize("outside", ["../outside.png", "/etc/hostname.png", "link.png"])
def test_images_that_a_list_names_elsewhere_are_not_read(tmp_path, name, file, first, outside):
    make_layouts.write_spot(tmp_path / "outside.png", 0)
    folder = LAYOUTS[name].make(tmp_path / "x")
    for home in (folder, folder / "images"):
        if home.is_dir():
            (home / "link.png").symlink_to(tmp_path / "outside.png")
    content = (folder / file).read_text()
    # From the folder ``images`` of COLMAP the way out has a step more.
    place = f"../{outside}" if outside.startswith("..") and name == "colmap-text" else outside
    write(folder / file, content.replace(first, place))
    if outside == "/etc/hostname.png" and name != "eth3d":
        assert "not in the folder" in open_source(folder).notes[0]
        return
    with pytest.raises(SourceError, match="leads out of the folder"):
        list(open_source(folder).frames())


@pytest.mark.parametrize("outside", ["/etc/hostname.png", "../../../../outside.png"])
def test_a_list_of_euroc_that_names_an_image_elsewhere_is_refused(tmp_path, outside):
    folder = make_layouts.euroc(tmp_path)
    index = folder / "mav0" / "cam0" / "data.csv"
    first, *others = index.read_text().splitlines()[-2:]
    write(index, "\n".join([f"{first.partition(',')[0]},{outside}", *others, ""]))
    with pytest.raises(SourceError, match="leads out of the folder"):
        list(open_source(folder).frames())


def test_images_that_are_not_in_the_folder_are_left_out_and_reported(tmp_path):
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
        ({"is_fisheye": "perhaps"}, "is_fisheye is 'perhaps'"),
        ({"k4": 0.1}, "k4 is not supported"),
        ({"frames": []}, "frames is missing or empty"),
        ({"frames": [{"file_path": 3}]}, "frame 0: file_path"),
        ({"frames": [{"file_path": "images/frame_1.png", "transform_matrix": [[1, 2], [3]]}]}, "no regular array"),
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


def test_a_frame_of_transforms_may_state_a_fisheye_of_its_own(tmp_path):
    path = make_layouts.transforms(tmp_path) / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"] = [frame | {"is_fisheye": k == 1} for k, frame in enumerate(content["frames"])]
    write(path, json.dumps(content))
    models = [image.camera.model for image in read_transforms(path, tmp_path)]
    assert models[1] == "fisheye" and "fisheye" not in models[:1] + models[2:]


def test_images_of_another_camera_are_left_out_and_reported():
    wide, tele = (Camera("pinhole", 640, 480, f, f, 320, 240) for f in (400, 800))
    camera, kept, notes = common_camera([wide, wide, tele, wide, None], "x")
    assert (camera, kept) == (wide, [True, True, False, True, False])
    assert notes == ("2 of 5 images are of another camera, and are left out",)
    with pytest.raises(CalibrationError, match="different cameras"):
        common_camera([wide, tele], "x")


def announced_by(load):
    """An entry point of another package."""
    return SimpleNamespace(value="package:LAYOUT", load=load)


def test_readers_of_other_packages_come_first_and_one_that_is_none_is_named(tmp_path, monkeypatch):
    write_image(tmp_path / "poster.png", picture(0, (800, 600)))
    announced = []
    monkeypatch.setattr(opening, "entry_points", lambda group: announced)
    assert open_source(tmp_path).kind == "images"
    announced.append(announced_by(lambda: LAYOUT))
    source = open_source(tmp_path)
    assert (source.kind, len(list(source.frames(0, 2)))) == ("poster", 2)
    for wrong, words in ((str, "no slam_init"), (lambda: 1 / 0, "division by zero")):
        announced[:] = [announced_by(wrong)]
        with pytest.raises(SourceError, match=f"package:LAYOUT.*{words}"):
            open_source(tmp_path)
