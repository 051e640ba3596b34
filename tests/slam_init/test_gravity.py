"""Laws of gravity that another sensor measured: it proposes motions, and no map is accepted because of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from make_two_views import NOISE_RAD, R_TRUE, box, is_true, views
from make_window import PRIORS, WINDOW_CONFIG, fitted_window, point_source

from quest import NoPose, PoseEvidence
from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets.views import at_rest, read_gravity
from slam_init.decision.two_views import MatchedPair, upright_or
from slam_init.errors import SourceError
from slam_init.initializer import Initializer
from slam_init.mapping.map_building import mean_gravity
from slam_init.types.frame import Frame, Observations
from slam_init.types.inertial import Gravity, InertialRecord
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from slam_init.window.equations import WindowEquations

DOWN = np.array([0.1, 0.97, -0.2]) / np.linalg.norm([0.1, 0.97, -0.2])
RNG = np.random.default_rng


def result_of(gravity_in):
    """The result of a simulated room; ``gravity_in`` makes of a true pose the gravity in its frame."""
    source = point_source("room", 2, baseline=0.1, views=8)
    initializer = Initializer(source.camera, WINDOW_CONFIG)
    for seen, pose in zip(source.observations(), source.groundtruth.world_from_cam, strict=True):
        if initializer.process_tracks(seen, gravity=gravity_in(pose)):
            break
    return initializer.finish(), source.groundtruth.world_from_cam


@pytest.fixture(scope="module")
def without():
    """The result without gravity."""
    return result_of(lambda _: None)[0]


def test_the_gravity_of_the_map_is_that_of_its_frames(without):
    result, poses = result_of(lambda pose: Gravity(pose.R.T @ DOWN, 0.5))
    first = result.map.keyframes[0]
    down = first.world_from_cam.R @ poses[first.frame].R.T @ DOWN
    assert np.degrees(np.arccos(result.map.gravity.down @ down)) < 0.3
    assert without.map.gravity is None


@pytest.mark.parametrize("kind", ["off by ten degrees", "constant", "random"])
def test_with_a_wrong_gravity_the_map_is_that_of_the_tracks(without, kind):
    rng, off = RNG(3), rotation_from_vector(np.radians([7.0, 0.0, 7.0]))
    wrong = {
        "off by ten degrees": lambda pose: Gravity(off @ pose.R.T @ DOWN, 0.5),
        "constant": lambda _: Gravity(DOWN, 0.5),
        "random": lambda _: Gravity(rng.normal(size=3), 0.5),
    }[kind]
    result, _ = result_of(wrong)
    assert [one.frame for one in result.map.keyframes] == [one.frame for one in without.map.keyframes]
    for one, other in zip(result.map.keyframes, without.map.keyframes, strict=True):
        np.testing.assert_allclose(one.world_from_cam.matrix(), other.world_from_cam.matrix(), atol=2e-3)
    contradicts = any("gravity is left out" in note for note in result.notes)
    assert contradicts == (result.map.gravity is None) == (kind == "random")


def with_gravity(tracks, state, sigma_rad=0.01):
    down = state.R @ DOWN
    weights = np.full(len(down), sigma_rad**-2)
    weights[0] = 0
    return replace(tracks, down=down, down_weights=weights)


def turned_about(state, view, vector_rad):
    R = state.R.copy()
    R[view] = rotation_from_vector(np.asarray(vector_rad)) @ R[view]
    return replace(state, R=R)


def gravity_cost(tracks, state):
    with_it, without = (
        WindowEquations(one, state, PRIORS).cost(state)
        for one in (tracks, replace(tracks, down_weights=np.zeros(len(tracks.frames))))
    )
    return with_it - without


def test_a_turn_about_gravity_costs_nothing_and_a_tilt_costs_its_square():
    fit = fitted_window("room", 1, 3)
    tracks, state = with_gravity(fit.tracks, fit.state), fit.state
    assert gravity_cost(tracks, state) == pytest.approx(0, abs=1e-6)
    assert gravity_cost(tracks, turned_about(state, 1, 0.05 * tracks.down[1])) == pytest.approx(0, abs=1e-6)
    across = np.cross(tracks.down[1], [1.0, 0.0, 0.0])
    tilt = 0.001 * across / np.linalg.norm(across)
    assert gravity_cost(tracks, turned_about(state, 1, tilt)) == pytest.approx(0.01 * 5 / 3, rel=0.02)


def test_a_tilt_that_is_too_large_costs_little_more_and_pulls_little():
    fit = fitted_window("room", 1, 3)
    tracks = with_gravity(fit.tracks, fit.state)
    across = np.cross(tracks.down[1], [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    pulls = [
        np.linalg.norm(WindowEquations(tracks, state, PRIORS).prior_gradient(state)[:12])
        for state in (turned_about(fit.state, 1, angle * across) for angle in (0.01, 0.3))
    ]
    assert pulls[1] < 0.2 * pulls[0]


def pair_of(outliers):
    m, n = views(box(0), noise_rad=NOISE_RAD, outliers=outliers)
    ids, none = np.arange(len(m)), np.zeros((len(m), 2))
    first, second = (Observations(frame, frame / 30, "", ids, none, rays) for frame, rays in ((0, m), (1, n)))
    return MatchedPair(None, first, second, none, none, m, n, ids)


def test_where_five_matches_find_no_motion_three_with_gravity_may():
    pair, none = pair_of(0.7), NoPose("no_consistent_motion", PoseEvidence(100))
    right = {0: Gravity(DOWN, 1.0), 1: Gravity(R_TRUE @ DOWN, 1.0)}
    found = upright_or(none, pair, right, 3 * NOISE_RAD, 0)
    assert any(is_true(one, rotation_deg=0.5, direction_deg=3) for one in (found, *found.alternatives))
    assert upright_or(none, pair, {0: right[0]}, 3 * NOISE_RAD, 0) is none
    assert upright_or(found, pair, {0: right[0], 1: Gravity(-DOWN, 1.0)}, 3 * NOISE_RAD, 0) is found


def test_directions_that_contradict_each_other_have_no_mean():
    keyframes = [Keyframe(k, k / 30, "", Pose.identity()) for k in range(3)]
    near, far = Gravity(DOWN, 1.0), Gravity(rotation_from_vector(np.array([0.2, 0, 0])) @ DOWN, 1.0)
    np.testing.assert_allclose(mean_gravity(keyframes, {0: near, 2: near}).down, DOWN)
    assert mean_gravity(keyframes, {0: near, 1: near, 2: far}) is None
    assert mean_gravity(keyframes, {7: near}) is None
    assert mean_gravity(keyframes, {0: near, 1: Gravity(-DOWN, 1.0)}) is None


def frame_at(time_s, name="a.png"):
    return Frame(0, time_s, name, np.zeros((4, 4), np.uint8))


def test_a_table_names_frames_or_times(tmp_path):
    table = tmp_path / "gravity.txt"
    table.write_text("# time or name, x, y, z, degrees\n1.5 0 2 0\n2.5,0,0,1,0.3\na.png 1 0 0\n")
    gravity_of = read_gravity(table)
    np.testing.assert_allclose(gravity_of(frame_at(1.51, "b.png")).down, [0, 1, 0])
    assert gravity_of(frame_at(2.5, "b.png")).sigma_deg == 0.3
    assert gravity_of(frame_at(2.0, "b.png")) is None
    np.testing.assert_allclose(gravity_of(frame_at(9.0)).down, [1, 0, 0])


@pytest.mark.parametrize("text", ["", "1.5 0 0 0\n", "1.5 0 1\n", "1.5 0 1 0 90\n", "nan 0 1 0\n"])
def test_a_broken_table_is_refused_with_its_name(tmp_path, text):
    table = tmp_path / "gravity.txt"
    table.write_text(text)
    with pytest.raises(SourceError, match=r"gravity\.txt"):
        read_gravity(table)


def test_an_accelerometer_determines_gravity_where_it_rests():
    times_s, R = np.arange(0, 4, 0.005), rotation_from_vector(np.array([0.2, 1.1, -0.4]))
    force = np.tile(-9.8 * R.T @ DOWN, (len(times_s), 1))
    force += (times_s > 2)[:, None] * np.sin(9 * times_s)[:, None] * [1.5, 0, 0]
    record = InertialRecord(times_s, np.zeros_like(force), force, Pose(R, np.zeros(3)))
    gravity_of = at_rest(record)
    rested = gravity_of(frame_at(1.0))
    assert rested.down @ DOWN > 1 - 1e-9
    assert 0.5 < rested.sigma_deg < 1
    assert gravity_of(frame_at(3.0)) is None
    assert gravity_of(frame_at(9.0)) is None
