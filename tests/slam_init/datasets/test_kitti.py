"""Sequences in the layout of KITTI odometry."""

import numpy as np
import pytest
from make_files import picture, write, write_image
from path_types import PATH_TYPES

from slam_init.datasets import open_source
from slam_init.datasets.kitti import find_kitti_images, open_kitti
from slam_init.errors import SourceError
from slam_init.types.camera import Camera


@pytest.fixture
def kitti(tmp_path):
    sequence = tmp_path / "dataset" / "sequences" / "06"
    for name in ("image_0", "image_2"):
        for i in range(2):
            write_image(sequence / name / f"{i:06d}.png", picture(i, channels=1))
    write(sequence / "times.txt", "0.000000e+00\n1.04e-01\n")
    row = "60 0 31 {} 0 60 23 0 0 0 1 0"
    write(sequence / "calib.txt", f"P0: {row.format(0)}\nP1: {row.format(-30)}\nP2: {row.format(6)}\nTr: 1\n")
    write(tmp_path / "dataset" / "poses" / "06.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 0 0 1 0 0 -1 0 0 2\n")
    return sequence


def test_images_times_camera_and_truth_of_a_kitti_sequence_are_read(kitti):
    source = open_source(str(kitti))
    assert (source.kind, source.name, len(source)) == ("kitti", "06/image_0", 2)
    assert source.camera == Camera("pinhole", 64, 48, 60, 60, 31, 23)
    np.testing.assert_allclose(source.timestamps_s, [0, 0.104])
    assert source.groundtruth.at(0.104).t.tolist() == [0, 0, 2]


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_the_readers_of_kitti_take_every_type_of_path(kitti, path_type):
    assert find_kitti_images(path_type(kitti)) == kitti / "image_0"
    assert len(open_kitti(path_type(kitti))) == 2


def test_kitti_truth_is_moved_to_the_camera_of_the_images(kitti):
    source = open_source(str(kitti / "image_2"))
    # K [I | t] with K t = (6, 0, 0): cam2_from_cam0 = (0.1, 0, 0), so that cam2 stands at -0.1 in cam0.
    np.testing.assert_allclose(source.groundtruth.at(0.0).t, [-0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(source.groundtruth.at(0.104).t, [0, 0, 2.1], atol=1e-12)


def test_kitti_poses_may_lie_in_the_folder_of_the_sequence(kitti):
    (kitti.parents[1] / "poses" / "06.txt").rename(kitti / "poses.txt")
    assert len(open_source(str(kitti)).groundtruth.world_from_cam) == 2


def test_images_behind_a_link_are_read_only_where_the_user_names_the_link(kitti):
    moved = kitti.parents[2] / "elsewhere" / "image_0"
    moved.parent.mkdir()
    (kitti / "image_0").rename(moved)
    (kitti / "image_0").symlink_to(moved)
    with pytest.raises(SourceError, match=r"image_0: leads out of the folder"):
        open_source(str(kitti))
    write(moved.parent / "times.txt", "0\n0.1\n")
    assert len(list(open_source(str(kitti / "image_0")).frames())) == 2


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("times.txt", "0\n", "1 times for 2 images"),
        ("times.txt", "0\nx\n", "times.txt:2"),
        ("times.txt", "1\n0\n", r"times.txt:2.*does not come after"),
        ("calib.txt", "P1: 1\n", "no line P0"),
        ("calib.txt", "P0: 1 2 3\n", "calib.txt:1"),
        ("calib.txt", "P0: 0 0 0 0 0 0 0 0 0 0 1 0\n", "focal"),
        ("../../poses/06.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 2 images"),
        ("../../poses/06.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n", "not a rotation"),
    ],
)
def test_broken_kitti_files_are_refused(kitti, name, text, word):
    write(kitti / name, text)
    with pytest.raises(SourceError, match=word):
        open_source(str(kitti))
