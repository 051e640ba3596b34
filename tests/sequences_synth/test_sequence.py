"""Synthetic sequences are deterministic and exact, each scene is what its name says, and files hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sequences_synth import SCENES, SynthOptions, make_sequence, write_tum

EXACT = {"width": 320, "height": 240, "noise": 0.0, "motion_blur": 0.0, "exposure_change": 0.0}
CLEAN = SynthOptions(**EXACT)
SMALL = replace(CLEAN, width=160, height=120)
TILTED = {"tilted-15": 15, "tilted-30": 30, "tilted-45": 45}
# Scenes whose camera moves in seconds and does not translate by default.
TIMED = ["handheld", "handheld-wall", "pan"]
MOVING = [name for name in SCENES if name not in ("static", "rotation", *TIMED)]


def plane_residual(sequence, depth):
    """Largest distance of a frame's points from their best plane, over the median depth."""
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(sequence.sensors[0].camera.K).T
    points = rays * depth.reshape(-1, 1).astype(float)
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    return np.abs(centred @ normal).max() / np.median(depth)


def test_a_frame_depends_neither_on_the_frames_before_nor_on_the_length_of_the_sequence():
    options = SynthOptions(width=160, height=120)
    first = make_sequence("room", 3, options)
    first.render(0)
    image, depth = first.render(30)
    shorter = make_sequence("room", 3, SynthOptions(width=160, height=120, frames=31))
    again, depth_again = shorter.render(30)
    assert np.array_equal(image, again)
    assert np.array_equal(depth, depth_again)
    assert np.array_equal(shorter.poses, first.poses[:31])


def test_planar_scenes_are_one_plane_and_others_are_not_and_all_fill_the_view():
    for name in ("wall", "nadir", "nadir-turn", *TILTED, "room", "corridor", "desk"):
        sequence = make_sequence(name, 0, SMALL)
        depth = sequence.render(99)[1]
        assert (depth > 0).all()
        residual = plane_residual(sequence, depth)
        assert residual > 0.05 if name in ("room", "corridor", "desk") else residual < 1e-4


@pytest.mark.parametrize("name", MOVING)
def test_moving_scenes_move_far_enough_and_smoothly(name):
    sequence = make_sequence(name, 0, SynthOptions(width=160, height=120))
    centres = sequence.poses[:, :3, 3]
    depth = np.median(sequence.render(0)[1])
    assert np.linalg.norm(centres - centres[0], axis=1).max() > 0.1 * depth
    assert np.linalg.norm(np.diff(centres, n=2, axis=0), axis=1).max() < 0.003 * depth


def test_noise_has_the_requested_size_and_is_independent_between_frames():
    options = SynthOptions(width=320, height=240, noise=4, motion_blur=0, exposure_change=0)
    noisy, clean = make_sequence("static", 0, options), make_sequence("static", 0, CLEAN)
    base = clean.render(0)[0].astype(float)
    mid = np.all(np.abs(base - 128) < 25, axis=-1)
    first, second = (noisy.render(i)[0].astype(float)[mid].mean(axis=-1) for i in (0, 1))
    assert np.std(first - base[mid].mean(axis=-1)) == pytest.approx(4, rel=0.1)
    assert abs(np.corrcoef(first - base[mid].mean(-1), second - base[mid].mean(-1))[0, 1]) < 0.1


def test_motion_blur_softens_the_image_without_a_shift():
    import cv2

    blurred = make_sequence("rotation", 0, SynthOptions(**{**vars(CLEAN), "motion_blur": 1.0})).render(60)[0]
    sharp = make_sequence("rotation", 0, CLEAN).render(60)[0]
    a, b = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32) for image in (sharp, blurred))
    assert np.abs(np.diff(b)).mean() < 0.85 * np.abs(np.diff(a)).mean()
    (dx, dy), _ = cv2.phaseCorrelate(a, b, cv2.createHanningWindow((320, 240), cv2.CV_32F))
    assert np.hypot(dx, dy) < 0.1


# -- sequences on disk -----------------------------------------------------------------------------


WRITTEN = SynthOptions(frames=3, width=160, height=120)


def test_a_written_folder_holds_images_poses_and_camera_of_the_sequence(tmp_path):
    import cv2
    import yaml

    sequence = make_sequence("nadir", 1, WRITTEN)
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
            write_tum(make_sequence("wall", 0, WRITTEN), tmp_path / name)
    assert (tmp_path / "full" / "mine.txt").read_text() == (tmp_path / "file").read_text() == "keep"


# -- shutter, lens and hand-held turning -----------------------------------------------------------


EXACT_SMALL = {**EXACT, "width": 160, "height": 120}


def pixel_poses(sensor, frame, pixels):
    """The poses that the camera had when it exposed pixels."""
    return np.stack([sensor.pose(float(f)) for f in frame + sensor.fps * sensor.shutter.delay_s(pixels)])


def transfer(sequence, i, j, depth):
    """Pixels of frame i transferred to frame j by the depth of i and the poses of the rows; their depth in frame j."""
    depth = depth.astype(float)
    camera = sequence.sensors[0].camera
    y, x = (a.ravel() for a in np.mgrid[: depth.shape[0] : 8, : depth.shape[1] : 8])
    pixels = np.column_stack([x, y]).astype(float)
    poses = pixel_poses(sequence.sensors[0], i, pixels)
    rays = camera.rays(pixels)
    X = rays / rays[:, 2:] * depth[y, x][:, None]
    X = np.einsum("nij,nj->ni", poses[:, :3, :3], X) + poses[:, :3, 3]
    there = pixels
    for _ in range(8):
        poses = pixel_poses(sequence.sensors[0], j, there)
        moved = np.einsum("ni,nij->nj", X - poses[:, :3, 3], poses[:, :3, :3])
        there = camera.project(np.column_stack([moved[:, :2], np.maximum(moved[:, 2], 0.1)]))
        there = np.clip(there, -200, 600)
    return pixels, there, moved[:, 2]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("corridor", {}),
        ("nadir", {}),
        ("room", {"readout_ms": 30.0, "readout_direction": "up"}),
        ("handheld", {"readout_ms": 30.0, "speed": 0.2}),
        ("handheld", {"k1": -0.2, "readout_ms": 20.0}),
        ("wall", {"lens": "radtan", "readout_ms": 30.0}),
        ("pan", {"k1": 0.2, "turning_deg_s": 30.0}),
    ],
)
def test_images_agree_with_depth_and_the_poses_of_the_rows(name, options):
    import cv2

    sequence = make_sequence(name, 1, SynthOptions(**EXACT_SMALL, frames=27, **options))
    i, j = 20, 26
    (image, depth_of_image), (other, depth_of_other) = sequence.render(i), sequence.render(j)
    pixels, there, depth = transfer(sequence, i, j, depth_of_image)
    where = there.astype(np.float32)[:, None]

    def at(source, shift=0.0, flag=cv2.INTER_LINEAR):
        return cv2.remap(source, where + np.float32(shift), None, flag)[:, 0]

    inside = (there > 2).all(axis=1) & (there < (157, 117)).all(axis=1)
    visible = inside & (np.abs(at(depth_of_other, flag=cv2.INTER_NEAREST) - depth) < 0.02 * depth)
    assert visible.mean() > 0.3
    colours = image[pixels[:, 1].astype(int), pixels[:, 0].astype(int)].astype(float)
    error = np.abs(at(other).astype(float) - colours)[visible].mean()
    shifted = np.abs(at(other, 0.5).astype(float) - colours)[visible].mean()
    assert error < 5
    assert error < 0.75 * shifted


def test_a_rolling_shutter_slants_what_a_pan_shows_and_the_middle_row_stays():
    rolled, at_once = (
        make_sequence("pan", 2, SynthOptions(**EXACT, readout_ms=r, turning_deg_s=90.0)).render(10)[0].astype(float)
        for r in (30.0, 0.0)
    )
    assert np.abs(rolled[120] - at_once[120]).mean() < 2
    assert np.abs(rolled[[0, 239]] - at_once[[0, 239]]).mean() > 8
