"""Laws of rendered worlds with shutter, lens and hand-held turning."""

from __future__ import annotations

import numpy as np
import pytest

from sequences_synth import SynthOptions, make_sequence
from sequences_synth.render import render, render_lines

CLEAN = {"width": 320, "height": 240, "noise": 0.0, "motion_blur": 0.0, "exposure_change": 0.0}
SMALL = {**CLEAN, "width": 160, "height": 120}


def transfer(sequence, i, j, depth):
    """Pixels of frame i transferred to frame j by the depth of i and the poses of the rows; their depth in frame j."""
    depth = depth.astype(float)
    camera = sequence.true_camera
    y, x = (a.ravel() for a in np.mgrid[: depth.shape[0] : 8, : depth.shape[1] : 8])
    pixels = np.column_stack([x, y]).astype(float)
    poses = sequence.sensors[0].pixel_poses(i, pixels)
    rays = camera.rays(pixels)
    X = rays / rays[:, 2:] * depth[y, x][:, None]
    X = np.einsum("nij,nj->ni", poses[:, :3, :3], X) + poses[:, :3, 3]
    there = pixels
    for _ in range(8):
        poses = sequence.sensors[0].pixel_poses(j, there)
        moved = np.einsum("ni,nij->nj", X - poses[:, :3, 3], poses[:, :3, :3])
        there = camera.project(np.column_stack([moved[:, :2], np.maximum(moved[:, 2], 0.1)]))
        there = np.clip(there, -200, 600)
    return pixels, there, moved[:, 2]


def test_a_render_with_one_pose_per_row_is_the_usual_render_where_all_poses_are_equal():
    sequence = make_sequence("desk", 1, SynthOptions(**CLEAN, frames=31))
    K, quads, pose = sequence.true_camera.K, sequence.sensors[0].world.quads, sequence.sensors[0].pose
    usual = render(quads, K, np.linalg.inv(pose(30)), 320, 240)
    lines = render_lines(quads, sequence.true_camera, lambda rows: np.full(len(rows), 30.0), pose)
    assert np.abs(usual.image.astype(int) - lines.image).max() <= 3
    assert np.mean(usual.ids != lines.ids) < 1e-3
    same = usual.ids == lines.ids
    np.testing.assert_allclose(lines.inverse_depth[same], usual.inverse_depth[same], atol=1e-5)


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

    sequence = make_sequence(name, 1, SynthOptions(**SMALL, frames=27, **options))
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
        make_sequence("pan", 2, SynthOptions(**CLEAN, readout_ms=r, turning_deg_s=90.0)).render(10)[0].astype(float)
        for r in (30.0, 0.0)
    )
    assert np.abs(rolled[120] - at_once[120]).mean() < 2
    assert np.abs(rolled[[0, 239]] - at_once[[0, 239]]).mean() > 8


@pytest.mark.parametrize(("name", "seed"), [("handheld", 0), ("handheld-wall", 1), ("pan", 2)])
def test_the_views_of_a_hand_held_camera_are_filled(name, seed):
    options = SynthOptions(**SMALL, frames=300, turning_deg_s=150, speed=0.2, k1=-0.1, readout_ms=30)
    sequence = make_sequence(name, seed, options)
    for index in (0, 299):
        assert (sequence.render(index)[1] > 0).all()
