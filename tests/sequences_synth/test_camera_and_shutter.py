"""Laws of the parts: lens, shutter, schedule, stabilizer and hand motion."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences_synth.camera import PinholeCamera, stated_camera
from sequences_synth.options import EffectOptions
from sequences_synth.schedule import Schedule
from sequences_synth.shutter import Shutter
from sequences_synth.stabilizer import LARGEST_WARP_RAD, virtual_from_cam
from sequences_synth.trajectory import (
    Arc,
    Handling,
    HandTurning,
    rotation_from_vector,
    rotations_from_vectors,
    vector_from_rotation,
)

SEEDS = st.integers(0, 2**32 - 1)


def camera(k1=0.0):
    return PinholeCamera(640, 480, 458.0, 458.0, 319.5, 239.5, k1)


@settings(max_examples=25)
@given(SEEDS, st.floats(-0.2, 1.0))
def test_the_ray_of_a_pixel_projects_to_the_pixel(seed, k1):
    lens = camera(k1)
    pixels = np.random.default_rng(seed).uniform((0, 0), (639, 479), (50, 2))
    distorted = np.linalg.norm((pixels - [319.5, 239.5]) / 458, axis=1)
    # A strong barrel distortion leaves the corners of the image black.
    inside = distorted < lens.largest_radius * (1 + k1 * lens.largest_radius**2) - 1e-3 if k1 < 0 else distorted >= 0
    np.testing.assert_allclose(lens.project(lens.rays(pixels))[inside], pixels[inside], atol=1e-6)


def test_the_stated_camera_has_the_errors_of_the_options_and_no_distortion():
    stated = stated_camera(camera(0.1), 0.05, 0.02, np.random.default_rng(0))
    assert stated.k1 == 0
    assert stated.fx == stated.fy == pytest.approx(1.05 * 458)
    assert abs(stated.cx - 319.5) == pytest.approx(0.02 * 640)
    assert abs(stated.cy - 239.5) == pytest.approx(0.02 * 480)
    assert stated_camera(camera(), 0, 0, np.random.default_rng(0)) == camera()


@pytest.mark.parametrize(
    ("direction", "early", "late"),
    [("down", (5, 0), (5, 480)), ("up", (5, 480), (5, 0)), ("right", (0, 5), (640, 5)), ("left", (640, 5), (0, 5))],
)
def test_the_shutter_runs_in_its_direction_and_the_middle_has_the_time_of_the_frame(direction, early, late):
    shutter = Shutter(0.03, direction, 640, 480)
    assert shutter.delay_s(np.array([early, late, (320.0, 240.0)])) == pytest.approx([-0.015, 0.015, 0.0])


@settings(max_examples=25)
@given(SEEDS, st.integers(2, 80), st.floats(0, 0.8), st.floats(0, 0.8), st.booleans())
def test_a_schedule_keeps_its_frames_ends_and_order(seed, frames, dropped, repeated, has_cut):
    cut = frames // 2 if has_cut and frames >= 4 else 0
    options = EffectOptions(dropped=dropped, repeated=repeated, cut=cut)
    schedule = Schedule.draw(np.random.default_rng(seed), frames, options)
    taken = max(frames, round(frames / (1 - dropped)))
    assert (schedule.ticks[0], schedule.ticks[-1], len(schedule.ticks)) == (0, taken - 1, frames)
    assert (np.diff(schedule.ticks) > 0).all()
    copies = schedule.content != np.arange(frames)
    assert copies.sum() == min(round(repeated * frames), frames - 1 - bool(cut))
    # A repeated frame shows what the frame before shows, and the first frame of a scene shows itself.
    assert (schedule.content[copies] == schedule.content[np.flatnonzero(copies) - 1]).all()
    assert not copies[0] and not copies[cut]


def test_without_options_a_schedule_is_every_frame_once():
    schedule = Schedule.draw(np.random.default_rng(1), 7, EffectOptions())
    np.testing.assert_array_equal(schedule.ticks, range(7))
    np.testing.assert_array_equal(schedule.content, range(7))
    assert schedule.scenes == (slice(0, 7),)


@settings(max_examples=25)
@given(SEEDS)
def test_rotations_of_many_vectors_are_those_of_each_and_the_logarithm_inverts_them(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(6, 3))
    vectors *= rng.uniform(0, 3.0, (6, 1)) / np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors[0] = 0.0
    vectors[1] *= 1e-9
    for vector, rotation in zip(vectors, rotations_from_vectors(vectors), strict=True):
        np.testing.assert_allclose(rotation, rotation_from_vector(vector), atol=1e-14)
        np.testing.assert_allclose(vector_from_rotation(rotation), vector, atol=1e-7)


@pytest.mark.parametrize("speed", [20.0, 60.0, 150.0])
@pytest.mark.parametrize("duration", [0.4, 2.0, 10.0])
@settings(max_examples=25)
@given(seed=SEEDS)
def test_hand_held_turning_has_the_requested_speed(speed, duration, seed):
    turning = HandTurning.draw(np.random.default_rng(seed), Handling(duration, speed, 0.0))
    R = rotations_from_vectors(turning.rotation_vector(np.linspace(0, duration, 2001)))
    steps = np.linalg.norm(np.diff(R, axis=0), axis=(1, 2)) / np.sqrt(2) * 2000 / duration
    assert np.degrees(np.sqrt(np.mean(steps**2))) == pytest.approx(speed, rel=0.02)


@settings(max_examples=25)
@given(seed=SEEDS)
def test_the_axis_of_hand_held_turning_changes_smoothly(seed):
    turning = HandTurning.draw(np.random.default_rng(seed), Handling(10.0, 60.0, 0.0))
    R = rotations_from_vectors(turning.rotation_vector(np.linspace(0, 10, 1001)))
    velocity = 100 * np.stack([vector_from_rotation(a.T @ b) for a, b in pairwise(R)])
    axes = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    # No axis dominates: the mean of the outer products has no eigenvalue near 1.
    assert np.linalg.eigvalsh(axes.T @ axes / len(axes))[-1] < 0.98
    # The angular acceleration is bounded: the hand is no hammer.
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 0.3


@settings(max_examples=25)
@given(seed=SEEDS, speed=st.floats(0.01, 2.0))
def test_an_arc_has_a_constant_speed_and_none_without_speed(seed, speed):
    rng = np.random.default_rng(seed)
    along, across = np.eye(3)[:2]
    times = np.linspace(0, 4, 401)
    steps = np.linalg.norm(np.diff(Arc.draw(rng, Handling(4, 0, speed), along, across).position(times), axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.01 * speed, rtol=1e-4)
    assert not Arc.draw(rng, Handling(4, 0, 0.0), along, across).position(times).any()


@settings(max_examples=25)
@given(seed=SEEDS)
def test_stabilization_smooths_and_its_warp_is_bounded(seed):
    turning = HandTurning.draw(np.random.default_rng(seed), Handling(4.0, 60.0, 0.0))
    # A tremor of 8 Hz and half a degree on top.
    tremor = np.radians(0.5) * np.array([1.0, 0.3, 0.0])

    def rotation(time_s):
        return rotation_from_vector(turning.rotation_vector(np.array(time_s)) + tremor * np.sin(50 * time_s))

    times = np.arange(0, 1.5, 1 / 30)
    warps = [virtual_from_cam(rotation, float(t)) for t in times]
    assert max(np.linalg.norm(vector_from_rotation(warp)) for warp in warps) < LARGEST_WARP_RAD

    def roughness(rotations):
        steps = np.stack([vector_from_rotation(a.T @ b) for a, b in pairwise(rotations)])
        return np.linalg.norm(np.diff(steps, axis=0))

    true = [rotation(float(t)) for t in times]
    assert roughness([R @ warp.T for R, warp in zip(true, warps, strict=True)]) < 0.7 * roughness(true)


def test_a_camera_at_rest_is_not_warped():
    fixed = rotation_from_vector(np.array([0.3, -0.2, 0.1]))
    np.testing.assert_allclose(virtual_from_cam(lambda _: fixed, 1.0), np.eye(3), atol=1e-14)
