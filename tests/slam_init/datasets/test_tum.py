"""Folders in the layout of TUM RGB-D and of ICL-NUIM."""

from itertools import pairwise

import numpy as np
import pytest
from make_files import picture, write, write_image
from path_types import PATH_TYPES
from paths import DATA

from slam_init.datasets import open_source
from slam_init.datasets.text import read_tum_trajectory
from slam_init.datasets.tum import open_tum
from slam_init.errors import SourceError
from slam_init.types.camera import Camera


def test_images_times_camera_and_truth_of_a_tum_folder_are_read(tum):
    source = open_source(str(tum))
    assert (source.kind, source.name, len(source)) == ("tum", tum.name, 3)
    assert source.camera == Camera("pinhole", 64, 48, 60, 60, 31.5, 23.5)
    frames = list(source.frames(1, 5))
    assert [(f.index, f.timestamp_s, f.name) for f in frames] == [(1, 0.1, "1.png"), (2, 0.2, "2.png")]
    np.testing.assert_array_equal(frames[0].image, picture(1))
    assert source.groundtruth.at(0.1).t.tolist() == [1, 0, 0]
    assert source.groundtruth.at(0.15) is None


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_open_tum_takes_every_type_of_path(tum, path_type):
    assert len(open_tum(path_type(tum))) == 3


def test_a_folder_without_a_list_of_images_is_refused(tmp_path):
    with pytest.raises(SourceError, match=r"rgb\.txt"):
        open_tum(tmp_path)


def test_file_names_in_rgb_txt_may_hold_spaces(tum):
    write_image(tum / "images" / "a b.png")
    write(tum / "rgb.txt", "0 images/a b.png\n")
    assert next(open_source(str(tum)).frames()).name == "a b.png"


@pytest.mark.parametrize(
    ("name", "text", "place"),
    [
        ("rgb.txt", "0 images/0.png\nx images/1.png\n", "rgb.txt:2"),
        ("rgb.txt", "0 images/0.png\n1\n", "rgb.txt:2"),
        ("rgb.txt", "1 images/0.png\n1 images/1.png\n", "rgb.txt:2"),
        ("rgb.txt", "nan images/0.png\n", "rgb.txt:1"),
        ("rgb.txt", "# nothing\n", "rgb.txt"),
        ("rgb.txt", b"\xff\xfe\x00\x80", "rgb.txt"),
        ("groundtruth.txt", "# t\n0 1 2 3\n", "groundtruth.txt:2"),
        ("groundtruth.txt", "0 0 0 0 0 0 0 0\n", "groundtruth.txt:1"),
        ("groundtruth.txt", "0 0 0 inf 0 0 0 1\n", "groundtruth.txt:1"),
    ],
)
def test_a_broken_line_is_refused_with_file_and_line(tum, name, text, place):
    write(tum / name, text)
    with pytest.raises(SourceError, match=place) as caught:
        open_source(str(tum))
    assert len(str(caught.value).splitlines()) == 1


def test_known_kinects_are_recognized_by_the_name_of_the_folder(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg2_desk"
    write_image(folder / "rgb" / "1.png")
    write(folder / "rgb.txt", "1 rgb/1.png\n")
    assert open_source(str(folder)).camera.fx == 520.908620


def test_associations_have_colour_and_depth_in_either_order(tmp_path):
    write_image(tmp_path / "rgb" / "1.png")
    write_image(tmp_path / "depth" / "1.png")
    for line in ("1.0 rgb/1.png 1.01 depth/1.png\n", "1.01 depth/1.png 1.0 rgb/1.png\n"):
        write(tmp_path / "associations.txt", line)
        source = open_source(str(tmp_path))
        assert (source.paths[0].parent.name, source.timestamps_s.tolist()) == ("rgb", [1.0])


def test_icl_nuim_poses_are_reflected_to_fit_the_images(tmp_path):
    """A camera that turns right and moves up in ICL-NUIM's frame (y up) must do so here (y down)."""
    for i in range(2):
        write_image(tmp_path / "rgb" / f"{i}.png", picture(i, (640, 480)))
    write(tmp_path / "associations.txt", "0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n")
    angle = 0.2
    write(
        tmp_path / "livingRoom0.gt.freiburg",
        f"0 0 0 0 0 0 0 1\n1 0 0.3 0 0 {np.sin(angle / 2)} 0 {np.cos(angle / 2)}\n",
    )
    source = open_source(str(tmp_path))
    assert source.camera == Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30])
    pose = source.groundtruth.at(1 / 30)
    assert pose.t.tolist() == [0, -0.3, 0]  # y points down: up is negative
    # The reflection keeps z forward and x right, so that the optical axis turns towards +x in both frames.
    np.testing.assert_allclose(pose.R[:, 2], [np.sin(angle), 0, np.cos(angle)], atol=1e-12)
    assert np.linalg.det(pose.R) == pytest.approx(1)


@pytest.mark.parametrize("name", ["../outside.png", "/etc/hostname", "images/link.png"])
def test_a_list_that_names_files_elsewhere_is_refused(tum, name):
    write_image(tum.parent / "outside.png")
    (tum / "images" / "link.png").symlink_to(tum.parent / "outside.png")
    write(tum / "rgb.txt", f"0 {name}\n")
    with pytest.raises(SourceError, match="leads out of the folder"):
        list(open_source(str(tum)).frames())


def test_a_missing_image_is_refused_by_name(tum):
    (tum / "images" / "1.png").unlink()
    with pytest.raises(SourceError, match=r"1\.png"):
        list(open_source(str(tum)).frames())


REAL = sorted(path.parent for path in DATA.glob("*/*/rgb.txt"))


@pytest.mark.skipif(not REAL, reason="no real sequences: set SLAM_INIT_DATA to their folder")
def test_real_sequences_open_as_they_are():
    for folder in REAL:
        source = open_source(str(folder))
        assert source.kind == "tum" and source.camera is not None and source.groundtruth is not None
        assert all(a < b for a, b in pairwise(source.timestamps_s))
        frame = next(source.frames())
        assert frame.gray.shape == (source.camera.height, source.camera.width)
        assert source.groundtruth.at(frame.timestamp_s) is not None


def test_a_position_of_the_truth_beyond_the_earth_is_refused(tmp_path):
    (tmp_path / "groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n1 1e300 0 0 0 0 0 1\n")
    with pytest.raises(SourceError, match=r"groundtruth.txt:2: the position .* is no place on earth"):
        read_tum_trajectory(tmp_path / "groundtruth.txt")


def test_a_table_of_a_million_lines_is_refused_before_it_is_parsed(tmp_path):
    (tmp_path / "groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n" * 1_000_000)
    with pytest.raises(SourceError, match="more than 600000 lines"):
        read_tum_trajectory(tmp_path / "groundtruth.txt")
