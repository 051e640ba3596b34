"""Laws of rendered worlds with shutter, exposure, hand-held turning, bodies, light, stabilization and cuts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sequences_synth import SynthOptions, make_sequence
from sequences_synth.render import render
from sequences_synth.render_lines import render_lines
from sequences_synth.trajectory import vector_from_rotation

CLEAN = {"width": 320, "height": 240, "noise": 0.0, "motion_blur": 0.0, "exposure_change": 0.0}
SMALL = {**CLEAN, "width": 160, "height": 120}


def grey(image):
    return image.astype(float).mean(axis=-1)


def transfer(sequence, i, j, depth):
    """Pixels of frame i transferred to frame j by the depth of i and the poses of the rows; their depth in frame j."""
    depth = depth.astype(float)
    camera = sequence.true_camera
    y, x = (a.ravel() for a in np.mgrid[: depth.shape[0] : 8, : depth.shape[1] : 8])
    pixels = np.column_stack([x, y]).astype(float)
    poses = sequence.pixel_poses(i, pixels)
    X = camera.rays(pixels) * depth[y, x][:, None]
    X = np.einsum("nij,nj->ni", poses[:, :3, :3], X) + poses[:, :3, 3]
    there = pixels
    for _ in range(8):
        poses = sequence.pixel_poses(j, there)
        moved = np.einsum("ni,nij->nj", X - poses[:, :3, 3], poses[:, :3, :3])
        there = camera.project(np.column_stack([moved[:, :2], np.maximum(moved[:, 2], 0.1)]))
        there = np.clip(there, -200, 600)
    return pixels, there, moved[:, 2]


@pytest.mark.parametrize("name", ["room", "wall", "desk"])
@pytest.mark.parametrize("by_columns", [False, True])
def test_a_render_with_one_pose_per_row_is_the_usual_render_where_all_poses_are_equal(name, by_columns):
    sequence = make_sequence(name, 1, SynthOptions(**CLEAN, frames=31))
    K, path = sequence.true_camera.K, sequence.world.path
    usual = render(sequence.world.quads, K, np.linalg.inv(path.world_from_cam(30)), 30, 320, 240)
    lines = render_lines(
        sequence.world.quads,
        sequence.true_camera,
        by_columns,
        lambda lines: np.full(len(lines), 30.0),
        path.world_from_cam,
    )
    assert np.abs(usual.image.astype(int) - lines.image).max() <= 3
    assert np.mean(usual.ids != lines.ids) < 1e-3
    same = usual.ids == lines.ids
    np.testing.assert_allclose(lines.inverse_depth[same], usual.inverse_depth[same], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("room", {"readout_ms": 30.0, "readout_direction": "up"}),
        ("handheld", {"readout_ms": 30.0, "speed": 0.2}),
        ("handheld", {"k1": -0.2, "readout_ms": 20.0, "readout_direction": "right"}),
        ("handheld-wall", {"stabilized": True, "readout_ms": 30.0, "speed": 0.1}),
        ("pan", {"stabilized": True, "k1": 0.2, "turning_deg_s": 30.0}),
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
    options = SynthOptions(**SMALL, frames=300, turning_deg_s=150, speed=0.2, k1=-0.1, stabilized=True, readout_ms=30)
    sequence = make_sequence(name, seed, options)
    for index in (0, 299):
        assert (sequence.render(index)[1] > 0).all()


@pytest.mark.parametrize(
    ("name", "share", "bodies"), [("handheld", 0.6, 1), ("room", 0.3, 3), ("desk", 0.5, 2), ("nadir", 0.2, 1)]
)
def test_the_bodies_fill_their_share_of_the_view(name, share, bodies):
    options = SynthOptions(**SMALL, moving=share, bodies=bodies, body_turn_deg_s=40.0)
    sequence = make_sequence(name, 5, options)
    shares = [sequence.moving_mask(index).mean() for index in range(0, 100, 18)]
    assert np.mean(shares) == pytest.approx(share, abs=0.08)
    assert np.ptp(shares) < 0.3
    assert len([quad for quad in sequence.world.quads if quad.moves]) == bodies
    np.testing.assert_array_equal(make_sequence(name, 5, SynthOptions(**SMALL)).poses, sequence.poses)


def test_a_body_is_rigid_and_turns_at_its_speed_with_respect_to_the_camera():
    sequence = make_sequence("handheld", 6, SynthOptions(**SMALL, moving=0.4, body_turn_deg_s=50.0))
    (board,) = [quad for quad in sequence.world.quads if quad.moves]
    path = sequence.world.path
    cam_from_body = [np.linalg.inv(path.world_from_cam(f)) @ board.body(f) for f in np.arange(0, 900, 1.0)]
    steps = [
        np.linalg.norm(vector_from_rotation(a[:3, :3].T @ b[:3, :3])) for a, b in itertools.pairwise(cam_from_body)
    ]
    assert np.degrees(np.sqrt(np.mean(np.square(steps)))) * 30 == pytest.approx(50, rel=0.05)
    moved = board.motion(3.0, 8.0)
    texels = np.array([[0, 0, 1], [5, 9, 1.0]]).T
    before, after = (board.world_from_texel(f) @ texels for f in (3.0, 8.0))
    np.testing.assert_allclose(moved[:3, :3] @ before + moved[:3, 3:], after, atol=1e-12)
    assert not np.allclose(before, after, atol=1e-3)


def test_a_long_exposure_is_the_mean_over_the_path_and_does_not_shift_the_image():
    import cv2

    sharp, blurred = (
        make_sequence("pan", 7, SynthOptions(**CLEAN, turning_deg_s=60.0, exposure_ms=e)) for e in (0.0, 30.0)
    )
    a, b = (grey(s.render(12)[0]).astype(np.float32) for s in (sharp, blurred))
    # The camera pans: the blur is horizontal. It is 8 px long.
    across, along = (np.abs(np.diff(b, axis=k)).mean() / np.abs(np.diff(a, axis=k)).mean() for k in (0, 1))
    assert along < 0.75 * across
    # At the centre of the image the blur is a mean over 262 px/rad times 1.8 deg, symmetric about the sharp image.
    trail = cv2.blur(a, (9, 1))

    def difference(shift):
        return np.abs(np.roll(trail, shift, axis=1) - b)[40:200, 40:280].mean()

    assert difference(0) < 0.4 * min(difference(-1), difference(1))
    assert difference(-1) == pytest.approx(difference(1), rel=0.1)
    np.testing.assert_array_equal(sharp.render(12)[1], blurred.render(12)[1])
    np.testing.assert_array_equal(sharp.poses, blurred.poses)


def test_both_kinds_of_motion_blur_agree():
    options = {**SMALL, "turning_deg_s": 150.0, "readout_ms": 20.0, "k1": -0.1}
    along, mean, sharp = (
        grey(make_sequence("handheld", 4, SynthOptions(**{**options, **kind})).render(9)[0])
        for kind in ({"motion_blur": 0.45}, {"exposure_ms": 15.0}, {})
    )
    assert np.abs(along - mean).mean() < 0.4 * np.abs(sharp - mean).mean()


def test_flicker_makes_bands_with_a_rolling_shutter_and_changes_frames_without_one():
    for readout_ms in (0.0, 30.0):
        plain, lit = (
            make_sequence("static", 8, SynthOptions(**SMALL, readout_ms=readout_ms, flicker=f)) for f in (0.0, 0.2)
        )
        rows = [(grey(lit.render(k)[0]) / np.maximum(grey(plain.render(k)[0]), 1)).mean(axis=1) for k in (0, 1, 2)]
        if readout_ms:
            # 100 Hz over 30 ms: three periods.
            assert all(np.ptp(row) > 0.3 for row in rows)
            assert abs(np.mean(rows[0]) - 1) < 0.03
        else:
            assert all(np.ptp(row) < 0.06 for row in rows)
        assert np.ptp([row[5] for row in rows]) > 0.1


def test_a_fade_rises_from_black_and_falls_to_black():
    sequence = make_sequence("static", 8, SynthOptions(**SMALL, frames=20, fade=4))
    light = np.array([sequence.render(k)[0].mean() for k in range(20)])
    expected = np.minimum(1, np.minimum(np.arange(1, 21), np.arange(20, 0, -1)) / 5)
    np.testing.assert_allclose(light / light[10], expected, atol=0.02)


def test_a_hand_held_scene_refuses_cards_and_names_the_bodies():
    with pytest.raises(ValueError, match=r"moving_objects.*option moving"):
        make_sequence("pan", 0, SynthOptions(**SMALL, moving_objects=0.2))
