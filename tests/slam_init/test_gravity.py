"""Laws of gravity that another sensor measured: the map states it, and no motion follows it."""

from __future__ import annotations

import numpy as np
import pytest
from make_window import WINDOW_CONFIG, point_source

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets.views import at_rest, read_gravity
from slam_init.errors import SourceError
from slam_init.mapping.map_building import mean_gravity
from slam_init.methods import make_initializer
from slam_init.types.frame import Frame
from slam_init.types.inertial import Gravity, InertialRecord
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose

DOWN = np.array([0.1, 0.97, -0.2]) / np.linalg.norm([0.1, 0.97, -0.2])
RNG = np.random.default_rng


def result_of(gravity_in, method="quest"):
    """The result of a simulated room; ``gravity_in`` makes of a true pose the gravity in its frame."""
    source = point_source("room", 2, baseline=0.1, views=8)
    initializer = make_initializer(method, source.camera, WINDOW_CONFIG)
    for seen, pose in zip(source.observations(), source.groundtruth.world_from_cam, strict=True):
        if initializer.process_tracks(seen, gravity=gravity_in(pose)):
            break
    return initializer.finish(), source.groundtruth.world_from_cam


@pytest.fixture(scope="module")
def without():
    """The result without gravity."""
    return result_of(lambda _: None)[0]


@pytest.mark.parametrize("method", ["quest", "orb-slam3"])
def test_the_gravity_of_the_map_is_that_of_its_frames(without, method):
    result, poses = result_of(lambda pose: Gravity(pose.R.T @ DOWN, 0.5), method)
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
    np.testing.assert_array_equal(result.map.poses, without.map.poses)
    contradicts = any("gravity is left out" in note for note in result.notes)
    assert contradicts == (result.map.gravity is None) == (kind == "random")


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
