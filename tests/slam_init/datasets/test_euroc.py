"""Sequences in the layout of EuRoC."""

import numpy as np
import pytest
from make_files import picture, write, write_image
from path_types import PATH_TYPES

from slam_init.datasets import open_source
from slam_init.datasets.euroc import find_euroc_camera, open_euroc
from slam_init.errors import SourceError
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

YAW_90 = Pose.from_quaternion(np.array([1.0, 0, 0, 1]), np.array([1.0, 2, 3]))


@pytest.fixture
def euroc(tmp_path):
    cam0 = tmp_path / "MH_01" / "mav0" / "cam0"
    stamps = [1403636579763555584, 1403636579813555456]
    for i, stamp in enumerate(stamps):
        write_image(cam0 / "data" / f"{stamp}.png", picture(i, channels=1))
    rows = "".join(f"{s},{s}.png\r\n" for s in stamps)
    write(cam0 / "data.csv", "#timestamp [ns],filename\r\n" + rows)
    T_BS = np.eye(4)
    T_BS[:3, :3], T_BS[:3, 3] = YAW_90.R, YAW_90.t
    write(
        cam0 / "sensor.yaml",
        f"T_BS:\n  rows: 4\n  cols: 4\n  data: {T_BS.ravel().tolist()}\nresolution: [64, 48]\n"
        "intrinsics: [60, 61, 31, 23]\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.2, 0.1, 0, 0]\n",
    )
    write(
        cam0.parent / "state_groundtruth_estimate0" / "data.csv",
        "#timestamp, p_RS_R_x [m], ...\n"
        + "".join(f"{s},5,6,7,0.7071067811865476,0.7071067811865476,0,0,0,0,0\n" for s in stamps),
    )
    return cam0.parent.parent


@pytest.mark.parametrize("sub", ["", "mav0", "mav0/cam0"])
def test_euroc_truth_is_the_pose_of_the_camera_for_every_folder_of_the_sequence(euroc, sub):
    source = open_source(str(euroc / sub))
    assert (source.kind, source.name, len(source)) == ("euroc", "MH_01", 2)
    assert source.camera == Camera("radtan", 64, 48, 60, 61, 31, 23, (-0.2, 0.1, 0, 0))
    assert source.timestamps_s[0] == 1403636579.763555584
    world_from_body = Pose.from_quaternion(np.array([1.0, 1, 0, 0]), np.array([5.0, 6, 7]))
    expected = world_from_body @ YAW_90
    pose = source.groundtruth.at(source.timestamps_s[1])
    np.testing.assert_allclose(pose.R, expected.R, atol=1e-12)
    np.testing.assert_allclose(pose.t, expected.t, atol=1e-12)
    assert next(source.frames()).image.ndim == 2


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_the_readers_of_euroc_take_every_type_of_path(euroc, path_type):
    assert find_euroc_camera(path_type(euroc)) == euroc / "mav0" / "cam0"
    assert len(open_euroc(path_type(euroc))) == 2


def test_a_broken_line_of_euroc_is_refused_with_file_and_line(euroc):
    write(euroc / "mav0" / "cam0" / "data.csv", "#t\n12x,a.png\n")
    with pytest.raises(SourceError, match=r"data\.csv:2"):
        open_source(str(euroc))
