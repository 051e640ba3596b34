"""Laws of the rolling shutter: rays are turned back to the middle of the readout, and the window finds the readout."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import fed, point_source, true_motion

from quest.geometry.quaternion import rotation_from_vector
from slam_init.frontend.rolling_shutter import RollingShutter, readout_places, turning_flow
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import History
from slam_init.types.refusal import Verdict
from slam_init.window.tracks import gather_tracks

#: The camera turns about a fixed axis, in rad/s.
TURN = np.array([0.6, -0.9, 0.3])


def turning(camera, readout_s, count=3, step_s=1 / 30, turn=TURN, seed=0):
    """Frames of points at infinity before a camera that turns steadily; their raw rays, and those of the middle."""
    rng = np.random.default_rng(seed)
    size = np.array([camera.width, camera.height], float)
    points = camera.bearings(rng.uniform(0.2 * size, 0.8 * size, (60, 2)))
    frames, middle = [], []
    for k in range(count):
        times = np.full(len(points), k * step_s)
        for _ in range(20):
            rays = np.einsum("nij,nj->ni", rotation_from_vector(times[:, None] * turn), points)
            pixels = camera.project(rays)
            times = k * step_s + ((pixels + 0.5) / size - 0.5) @ readout_s
        middle.append(points @ rotation_from_vector(k * step_s * turn).T)
        frames.append(Observations(k, k * step_s, str(k), np.arange(len(points)), pixels, camera.bearings(pixels)))
    return frames, middle


def sweep_of(camera, observations):
    """Derivatives of the raw pixels by the readout."""
    flow_px_s = turning_flow(camera, observations.bearings, observations.turn_rad_s)
    return flow_px_s * readout_places(camera, observations.pixels)[:, None]


def vector(camera):
    """Readouts of all columns and of all rows."""
    return camera.readout_s * np.array(camera.readout_axis)


def corrected_frames(camera, frames):
    history, shutter = History(camera, 100), RollingShutter(camera)
    for one in frames:
        history.add(one)
        shutter.correct_newest(history, one.frame)
    return history, shutter


@pytest.mark.parametrize(
    ("model", "direction"), [("pinhole", "down"), ("radtan", "up"), ("fisheye", "right"), ("pinhole", "left")]
)
def test_rays_are_turned_back_to_the_middle_of_the_readout(model, direction):
    camera = replace(CAMERAS[model], readout_ms=30.0, readout_direction=direction)
    frames, middle = turning(camera, vector(camera))
    history, _ = corrected_frames(camera, frames)
    # The turning is that between raw rays, so it is off by a share of the readout over the step.
    np.testing.assert_allclose(history[1].turn_rad_s, TURN, atol=0.05)
    before = np.abs(frames[1].bearings - middle[1]).max()
    assert np.abs(history[1].bearings - middle[1]).max() < 0.06 * before


def test_the_turning_of_a_single_step_is_uncertain_and_that_of_two_steps_is_not():
    """A hand that swings changes its turning by a sixth of itself in half a frame interval."""
    camera = replace(CAMERAS["pinhole"], readout_ms=30.0)
    frames, _ = turning(camera, vector(camera))
    assert [one.turn_error for one in corrected_frames(camera, frames[:2])[0]] == pytest.approx([2.5 / 30] * 2)
    assert [one.turn_error for one in corrected_frames(camera, frames)[0]] == [0.0] * 3


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_the_sweep_is_the_derivative_of_the_raw_pixels_by_the_readout(model):
    camera = CAMERAS[model]
    for direction in ("down", "left"):
        rolls = replace(camera, readout_ms=0.1, readout_direction=direction)
        plain, rolling = turning(camera, np.zeros(2))[0][1], turning(camera, vector(rolls))[0][1]
        sweep = sweep_of(rolls, replace(plain, turn_rad_s=TURN))
        np.testing.assert_allclose(sweep, (rolling.pixels - plain.pixels) / 1e-4, rtol=2e-3, atol=0.5)


def test_an_adopted_readout_corrects_all_frames_as_if_it_had_been_known():
    camera = CAMERAS["pinhole"]
    frames, _ = turning(camera, np.array([0.0, 0.03]), count=5)
    history, shutter = corrected_frames(camera, frames)
    np.testing.assert_array_equal(history[2].bearings, frames[2].bearings)
    assert shutter.adopt(history, 0.02)
    assert shutter.adopt(history, 0.03)
    assert not shutter.adopt(history, 0.03)
    known, _ = corrected_frames(replace(camera, readout_ms=30.0), frames)
    for one in history:
        # A known readout also corrects the rays that the turning is found from.
        np.testing.assert_allclose(one.bearings, known[one.frame].bearings, atol=2e-4)
        np.testing.assert_array_equal(one.pixels, frames[one.frame].pixels)


@pytest.mark.parametrize("case", ["photographs", "repeated time stamps", "few tracks", "a cut"])
def test_nothing_is_corrected_where_the_turning_is_not_known(case):
    camera = replace(CAMERAS["pinhole"], readout_ms=30.0)
    frames, _ = turning(camera, np.zeros(2))
    if case == "photographs":
        frames = [replace(one, timestamp_s=float(one.frame)) for one in frames]
    if case == "repeated time stamps":
        frames = [replace(one, timestamp_s=0.0) for one in frames]
    if case == "few tracks":
        frames = [one.at(np.arange(7)) for one in frames]
    if case == "a cut":
        frames = [replace(one, track_ids=one.track_ids + 1000 * one.frame) for one in frames]
    history, _ = corrected_frames(camera, frames)
    assert all(one.turn_rad_s is None for one in history)
    assert not gather_tracks(camera, list(history), 0.3).sweep_px_s.any()


def run(seed, **options):
    options = {"views": 45, "fps": 30.0, "turning_deg_s": 60.0, "noise_px": 0.5, "outliers": 0.1} | options
    source = point_source("handheld", seed, **options)
    return source, fed(Initializer(source.camera), source.observations())


@pytest.mark.slow
def test_a_hand_held_rolling_shutter_is_found_together_with_the_map():
    source, initializer = run(40, readout_ms=30.0, readout_direction="up", speed=0.03, noise_px=0.3, points=200)
    map_ = initializer.map
    assert map_ is not None
    assert map_.camera.readout_direction == "up"
    assert map_.camera.readout_s == pytest.approx(0.03, abs=0.004)
    assert any(note.startswith("a rolling shutter was corrected") for note in initializer.result.notes)
    evidence = initializer.status.attempt.window
    assert evidence.readout_ms == pytest.approx(map_.camera.readout_ms)
    # Three standard deviations hold the truth, and are less than all that is known before.
    bound_s = 3 * evidence.readout_sigma_ms / 1000
    assert abs(map_.camera.readout_s - 0.03) <= bound_s <= 1 / 60
    first, last = map_.keyframes[0], map_.keyframes[-1]
    true = true_motion(source, first.frame, last.frame)
    found = last.world_from_cam.inverse() @ first.world_from_cam
    turned_deg = np.degrees(np.arccos((np.trace(true.R.T @ found.R) - 1) / 2))
    assert turned_deg < 1


@pytest.mark.slow
def test_a_camera_that_only_turns_is_distinguished_from_one_that_translates():
    _, initializer = run(41, readout_ms=30.0, views=15)
    assert initializer.map is None
    assert initializer.result.reason == Verdict.PURE_ROTATION
    estimates = [a.window.readout_ms for a in initializer.result.attempts if a.window is not None]
    assert all(one is not None for one in estimates)


def test_a_camera_states_its_readout():
    camera = Camera("pinhole", 640, 480, 458.0, 458.0, 319.5, 239.5)
    assert camera.readout_s is None
    upright = replace(camera, width=480, height=640)
    found = {(one.width, seconds): one.with_readout(seconds) for one in (camera, upright) for seconds in (0.02, -0.02)}
    directions = {key: one.readout_direction for key, one in found.items()}
    assert directions == {(640, 0.02): "down", (640, -0.02): "up", (480, 0.02): "right", (480, -0.02): "left"}
    for one in found.values():
        assert one.readout_s == pytest.approx(0.02)
        assert one.with_readout(0.03).readout_direction == one.readout_direction
