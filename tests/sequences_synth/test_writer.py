"""Sequences on disk: files hold what was rendered."""

from __future__ import annotations

import numpy as np
import pytest

from sequences_synth import SynthOptions, make_sequence, write_tum

SMALL = SynthOptions(frames=3, width=160, height=120)


def test_a_written_folder_holds_images_poses_and_camera_of_the_sequence(tmp_path):
    import cv2
    import yaml

    sequence = make_sequence("nadir", 1, SMALL)
    reported = []
    write_tum(sequence, tmp_path / "a" / "b", reported.append)
    folder = tmp_path / "a" / "b"
    assert reported == [1, 2, 3]
    rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if line[0] != "#"]
    truth = np.loadtxt(folder / "groundtruth.txt")
    for i, row in enumerate(rows):
        image, _ = sequence.render(i)
        assert np.array_equal(cv2.imread(str(folder / row[1]), cv2.IMREAD_UNCHANGED), image)
        assert float(row[0]) == pytest.approx(sequence.timestamps_s[i], abs=1e-6)
        assert np.allclose(truth[i, 1:4], sequence.poses[i, :3, 3], atol=1e-8)
        x, y, z, w = truth[i, 4:]
        R = np.eye(3) + 2 * w * np.cross(np.eye(3), [x, y, z])
        R += 2 * (np.outer([x, y, z], [x, y, z]) - (x * x + y * y + z * z) * np.eye(3))
        assert np.allclose(R, sequence.poses[i, :3, :3], atol=1e-7)
    camera = yaml.safe_load((folder / "camera.yaml").read_text())
    assert (camera["model"], camera["distortion_model"], camera["distortion"]) == ("pinhole", "none", [])
    for key in ("width", "height", "fx", "fy", "cx", "cy"):
        assert camera[key] == getattr(sequence.camera, key)


def test_existing_files_are_not_overwritten(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    (tmp_path / "file").write_text("keep")
    for name in ("full", "file"):
        with pytest.raises(FileExistsError, match="name a new or an empty folder"):
            write_tum(make_sequence("wall", 0, SMALL), tmp_path / name)
    assert (tmp_path / "full" / "mine.txt").read_text() == (tmp_path / "file").read_text() == "keep"
