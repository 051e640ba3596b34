"""Synthetic sequences are deterministic, their geometry is exact, and each scene is what its name says."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from sequences_synth import SCENES, SynthOptions, make_sequence

CLEAN = SynthOptions(width=320, height=240, noise=0, motion_blur=0, exposure_change=0)
SMALL = replace(CLEAN, width=160, height=120)
TILTED = {"tilted-15": 15, "tilted-30": 30, "tilted-45": 45}
# Scenes whose camera moves in seconds and does not translate by default.
TIMED = ["handheld", "handheld-wall", "pan"]
MOVING = [name for name in SCENES if name not in ("static", "rotation", *TIMED)]


def plane_residual(sequence, depth):
    """Largest distance of a frame's points from their best plane, over the median depth."""
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(sequence.true_camera.K).T
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


def test_scene_rotation_has_no_baseline():
    poses = make_sequence("rotation", 4).poses
    assert np.ptp(poses[:, :3, 3], axis=0).max() == 0
    assert np.degrees(np.arccos((np.trace(poses[0, :3, :3].T @ poses[-1, :3, :3]) - 1) / 2)) > 15


def test_rotate_then_move_starts_without_translation():
    sequence = make_sequence("rotate-then-move", 5)
    assert np.ptp(sequence.poses[:40, :3, 3], axis=0).max() == 0
    assert np.linalg.norm(sequence.poses[99, :3, 3] - sequence.poses[0, :3, 3]) > 0.4


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


def test_importing_the_package_imports_neither_slam_init_nor_quest_nor_opencv():
    code = "import sequences_synth, sys; print([m for m in sys.modules if m in ('slam_init', 'quest', 'cv2')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
