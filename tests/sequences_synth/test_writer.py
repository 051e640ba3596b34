"""Sequences on disk: files hold what was rendered, and an incomplete folder is never left behind."""

from __future__ import annotations

import numpy as np
import pytest
from path_types import PATH_TYPES

from sequences_synth import SynthOptions, make_sequence, write_euroc, write_tum
from slam_init.datasets import open_source

SMALL = SynthOptions(frames=3, width=160, height=120)


@pytest.mark.parametrize("name", ["room", "nadir"])
def test_a_written_folder_holds_images_depths_poses_and_camera_of_the_sequence(tmp_path, name):
    import cv2
    import yaml

    sequence = make_sequence(name, 1, SMALL)
    reported = []
    write_tum(sequence, tmp_path / "a" / "b", reported.append)
    folder = tmp_path / "a" / "b"
    assert reported == [1, 2, 3]
    rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if line[0] != "#"]
    depths = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if line[0] != "#"]
    truth = np.loadtxt(folder / "groundtruth.txt")
    text = (folder / "camera.yaml").read_text()
    factor = float(text.split("metres times ")[1].split(",")[0])
    for i, (row, depth_row) in enumerate(zip(rows, depths, strict=True)):
        image, depth = sequence.render(i)
        assert np.array_equal(cv2.imread(str(folder / row[1]), cv2.IMREAD_UNCHANGED), image)
        read = cv2.imread(str(folder / depth_row[1]), cv2.IMREAD_UNCHANGED)
        assert read.dtype == np.uint16
        assert np.abs(read / factor - depth).max() <= 0.51 / factor
        assert float(row[0]) == pytest.approx(sequence.timestamps_s[i], abs=1e-6)
        assert np.allclose(truth[i, 1:4], sequence.poses[i, :3, 3], atol=1e-8)
        x, y, z, w = truth[i, 4:]
        R = np.eye(3) + 2 * w * np.cross(np.eye(3), [x, y, z])
        R += 2 * (np.outer([x, y, z], [x, y, z]) - (x * x + y * y + z * z) * np.eye(3))
        assert np.allclose(R, sequence.poses[i, :3, :3], atol=1e-7)
    camera = yaml.safe_load(text)
    assert (camera["model"], camera["distortion_model"], camera["distortion"]) == ("pinhole", "none", [])
    for key in ("width", "height", "fx", "fy", "cx", "cy"):
        assert camera[key] == getattr(sequence.camera, key)


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_write_tum_takes_every_type_of_path(tmp_path, path_type):
    write_tum(make_sequence("wall", 0, SynthOptions(frames=1, width=64, height=64)), path_type(tmp_path / "out"))
    assert (tmp_path / "out" / "rgb.txt").is_file()


def test_an_interrupted_write_leaves_no_file_behind(tmp_path):
    def crash(done):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_tum(make_sequence("wall", 0, SMALL), tmp_path / "out", crash)
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_not_overwritten(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    (tmp_path / "file").write_text("keep")
    for name in ("full", "file"):
        with pytest.raises(FileExistsError, match="name a new or an empty folder"):
            write_tum(make_sequence("wall", 0, SMALL), tmp_path / name)
    assert (tmp_path / "full" / "mine.txt").read_text() == (tmp_path / "file").read_text() == "keep"


def test_a_sequence_with_a_sensor_is_read_again_as_one_of_euroc(tmp_path):
    sequence = make_sequence("room", 2, SynthOptions(frames=3, width=96, height=64, imu=True))
    write_euroc(sequence, tmp_path / "seq")
    source, record = open_source(tmp_path / "seq"), sequence.inertial()
    assert (source.kind, source.camera.fx, len(source)) == ("euroc", sequence.camera.fx, 3)
    np.testing.assert_allclose(np.diff(source.timestamps_s), np.diff(sequence.timestamps_s), atol=1e-8)
    for frame, pose in zip(source.frames(), sequence.poses, strict=True):
        assert np.array_equal(frame.image, sequence.render(frame.index)[0])
        np.testing.assert_allclose(source.groundtruth.at(frame.timestamp_s).matrix(), pose, atol=1e-7)
    read = source.inertial
    np.testing.assert_allclose(read.cam_from_imu.matrix(), record.cam_from_imu, atol=1e-9)
    np.testing.assert_allclose(read.accelerations_m_s2, record.accelerations_m_s2, atol=1e-8)
    np.testing.assert_allclose(read.timestamps_s - source.timestamps_s[0], record.timestamps_s, atol=1e-8)
    assert read.accelerometer_density == record.noise.accelerometer_density
    with pytest.raises(ValueError, match="no inertial sensor"):
        write_euroc(make_sequence("room", 2, SMALL), tmp_path / "other")
