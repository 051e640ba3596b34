"""Laws of the two views of a pair: their matches, their relative pose, and the refusal of a pure rotation."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_pair import estimated, matched
from make_scene import CAMERA, CONFIG, cloud, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.two_views import pose_at_fitting_threshold, refuse_two_views
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Stage, Verdict
from slam_init.types.result import Attempt

POSES = make_poses(4)


def views(poses=POSES, noise_px=0.3):
    rng = np.random.default_rng(0)
    return observe(CAMERA, poses, cloud(rng, 300), noise_px, rng)


@pytest.fixture(scope="module")
def rotating():
    """The pose of a pair of a rotation-only camera."""
    return estimated(views([Pose.identity(), Pose(rotation_from_vector(np.array([0.0, 0.05, 0.0])), np.zeros(3))]))


def test_the_outlier_threshold_is_widened_for_noisy_tracks():
    stated = CONFIG.two_view.threshold_px / CAMERA.focal_px
    _, threshold_rad = pose_at_fitting_threshold(CAMERA, CONFIG, matched(views()))
    assert threshold_rad == stated
    pose, threshold_rad = pose_at_fitting_threshold(CAMERA, CONFIG, matched(views(make_poses(5), noise_px=2.0)))
    assert threshold_rad == pytest.approx(3 * stated)
    assert pose.inliers.mean() > 0.9


def test_a_rotation_is_pure_rotation_and_one_within_the_noise_is_a_static_camera(rotating):
    assert rotating.kind == "rotation"
    attempt = refuse_two_views(CAMERA, CONFIG, Attempt((0, 1), Verdict.ACCEPTED), rotating)
    assert (attempt.verdict, attempt.stage) == (Verdict.PURE_ROTATION, Stage.MOTION)
    within_noise = rotation_from_vector(np.array([0.0, 0.1 / CAMERA.focal_px, 0.0]))
    static = refuse_two_views(CAMERA, CONFIG, Attempt((0, 1), Verdict.ACCEPTED), replace(rotating, R=within_noise))
    assert (static.verdict, static.stage) == (Verdict.STATIC_CAMERA, Stage.MOTION)
    assert [gate.name for gate in static.failed_gates] == [GateName.ROTATION_PX]
