"""Laws of the initializer of a two-view method: its references, its bundle adjustment, its result."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, observe, plane

from slam_init.methods import METHODS, make_initializer
from slam_init.methods.pair_initializer import PairInitializer
from slam_init.methods.two_view import PairRule, TwoViewOutcome
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName


def tracks_of(points, noise_px=0.3, count=8):
    return observe(CAMERA, make_poses(count), points, noise_px, np.random.default_rng(1))


def general_tracks(count=300):
    return tracks_of(cloud(np.random.default_rng(0), count))


def finished(initializer, observations):
    """The result after the observations, or after the map."""
    for observed in observations:
        initializer.process_tracks(observed)
        if initializer.map is not None:
            break
    return initializer.finish()


@pytest.mark.parametrize("name", [n for n in METHODS if n not in ("colmap", "homography")])
def test_each_method_makes_a_correct_map_of_tracks(name):
    if METHODS[name].needs:
        pytest.importorskip(METHODS[name].needs)
    initializer = make_initializer(name, CAMERA, CONFIG)
    result = finished(initializer, general_tracks())
    assert result, result.reason
    assert initializer.frames_read == result.frames_to_init
    first, *others = result.map.keyframes
    np.testing.assert_allclose(first.world_from_cam.R, np.eye(3), atol=1e-6)
    truth = make_poses(8)
    for keyframe in others:
        true = truth[first.frame].inverse() @ truth[keyframe.frame]
        cosine = keyframe.world_from_cam.t @ true.t
        assert cosine > np.cos(np.deg2rad(5)) * np.linalg.norm(keyframe.world_from_cam.t) * np.linalg.norm(true.t)
    assert result.map.graph.size() > 0
    assert len(result.map.colors) == len(result.map.points)
    assert (result.map.colors == 128).all()  # tracks without colors are grey


class Refusing:
    """A method that refuses each pair."""

    pair_rule = PairRule(min_features=100, min_matches=60, min_landmarks=50)

    def bootstrap(self, camera, pixels1, pixels2, bearings1, bearings2, seed):
        return TwoViewOutcome.refused("low_parallax", len(pixels1), {"seen": len(pixels1)})


class Accepting(Refusing):
    """A method that accepts a motion sideways, with points at a depth of four baselines along their rays."""

    def __init__(self, depth=4.0):
        self.depth = depth

    def bootstrap(self, camera, pixels1, pixels2, bearings1, bearings2, seed):
        points = self.depth * bearings1 / bearings1[:, 2:]
        return TwoViewOutcome.accepted(
            Pose(np.eye(3), np.array([1.0, 0, 0])), np.ones(len(points), bool), points, False, {"score": 0.5}
        )


def test_the_reference_stays_until_its_tracks_are_lost():
    observations = general_tracks(200)
    lost = [replace(o, track_ids=o.track_ids + (1000 if k >= 4 else 0)) for k, o in enumerate(observations)]
    initializer = PairInitializer(Refusing(), CAMERA, CONFIG)
    attempts = [initializer.process_tracks(observed).attempt for observed in lost]
    assert attempts[0] is None
    assert [attempt.frames for attempt in attempts[1:]] == [(0, 1), (0, 2), (0, 3), (0, 4), (4, 5), (4, 6), (4, 7)]
    assert attempts[4].verdict == "too_few_matches"
    assert attempts[5].method_evidence["seen"] == 200
    assert initializer.finish().reason == "low_parallax"


def test_a_reference_needs_enough_features():
    observations = general_tracks(90)
    initializer = PairInitializer(Refusing(), CAMERA, CONFIG)
    assert not finished(initializer, observations)
    assert initializer.finish().reason == "too_few_features"
    assert PairInitializer(Refusing(), CAMERA, CONFIG).finish().reason == "too_few_frames"


def test_the_pair_rule_and_the_landmarks_are_the_gates_of_an_attempt():
    result = finished(PairInitializer(Refusing(), CAMERA, CONFIG), general_tracks())
    assert [gate.name for gate in result.attempts[-1].gates] == [GateName.FEATURES, GateName.MATCHES]
    result = finished(make_initializer("orb-slam3", CAMERA, CONFIG), general_tracks())
    assert [gate.name for gate in result.attempts[-1].gates][-1] is GateName.LANDMARKS
    assert result.attempts[-1].map.reprojection_rmse_px == result.map.reprojection_rmse_px


def test_points_behind_the_camera_do_not_survive_bundle_adjustment_and_the_next_frame_becomes_the_reference():
    initializer = PairInitializer(Accepting(depth=-4.0), CAMERA, CONFIG)
    result = finished(initializer, tracks_of(plane(np.random.default_rng(0), 200)))
    assert not result
    assert result.reason == "bundle_adjustment_failed"
    assert result.attempts[-1].map.failure
    assert [attempt.frames for attempt in result.attempts][:2] == [(0, 1), (1, 2)]
