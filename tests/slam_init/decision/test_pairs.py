"""Laws of the decision on a pair: refusals by the previews, the relative pose, and when a camera only rotates."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses, make_window_evidence
from make_pair import estimated, matched, preview_of
from make_scene import CAMERA, CONFIG, cloud, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.screening import screen
from slam_init.decision.two_views import pose_at_fitting_threshold, refuse_two_views, with_established_reason
from slam_init.frontend.keyframes import PairPreview
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Stage, Verdict, at_most
from slam_init.types.result import Attempt

NEEDED = CONFIG.keyframes.min_matches
(CURRENT,) = observe(CAMERA, make_poses(1), cloud(np.random.default_rng(0), 2 * NEEDED), frames=[7])
FEW = observe(CAMERA, make_poses(1), cloud(np.random.default_rng(0), NEEDED - 1), frames=[7])[0]


def pair(reference=3, matches=2 * NEEDED, motion_px=30.0, rotation_deg=2.0, parallax_share=0.5):
    return PairPreview(matches, motion_px, rotation_deg, 5.0, parallax_share, 0.5, reference, 7, 1.0)


def screened(*pairs, current=CURRENT):
    return screen(CAMERA, CONFIG, current, pairs)


@pytest.mark.parametrize(
    ("changed", "reason", "stage", "gate"),
    [
        ({"matches": NEEDED - 1}, Verdict.TOO_FEW_MATCHES, Stage.MATCHES, GateName.MATCHES),
        ({"motion_px": 0.1}, Verdict.STATIC_CAMERA, Stage.MOTION, GateName.MOTION_PX),
        ({"parallax_share": 0.05, "rotation_deg": 0.01}, Verdict.STATIC_CAMERA, Stage.MOTION, GateName.ROTATION_PX),
    ],
)
def test_each_lack_refuses_for_its_own_reason(changed, reason, stage, gate):
    attempt = screened(pair(**changed))
    assert (attempt.verdict, attempt.stage, attempt.frames) == (reason, stage, (3, 7))
    assert attempt.failed_gates[0].name is gate
    assert attempt.advice == attempt.failed_gates[0].advice
    assert attempt.preview == pair(**changed).evidence


def test_a_rotation_without_parallax_is_left_to_the_window():
    assert screened(pair(parallax_share=0.0)) is None


def test_a_frame_with_too_few_features_is_refused_for_its_features_first():
    attempt = screened(pair(matches=NEEDED - 1), current=FEW)
    assert attempt.verdict == Verdict.TOO_FEW_FEATURES


def test_one_good_pair_is_enough():
    assert screened(pair(0, motion_px=0.1, parallax_share=0.0), pair(5)) is None
    assert screened(pair(0, matches=NEEDED - 1), pair(5)) is None


# -- laws of the two views of a pair: their matches, their relative pose, and the refusal of a pure rotation


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


# -- a camera only rotates where a rotation is established; a short translation is not called one


def refused(degrees, t, noise_px=0.2, window=None):
    """The reason of a pair before a frontal wall at the distance 1 that looks like a pure rotation."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform([-0.9, -0.7], [0.9, 0.7], (800, 2)), np.ones(800)])
    poses = [Pose.identity(), Pose(rotation_from_vector(np.array([0.0, np.radians(degrees), 0.0])), np.array(t))]
    seen = observe(CAMERA, poses, points, noise_px, rng)
    gate = at_most(GateName.RISK, 1.0, 0.005, Verdict.PURE_ROTATION)
    attempt = Attempt((0, 1), Verdict.PURE_ROTATION, gates=(gate,), preview=preview_of(seen).evidence)
    named = with_established_reason(CAMERA, replace(attempt, window=window))
    assert named.gates[0].reason is named.verdict and named.gates[0].value == gate.value
    return named.verdict


def test_a_rotation_is_said_once_it_is_established_and_never_of_a_translation():
    still = (0.0, 0.0, 0.0)
    assert refused(0.3, still) is Verdict.LOW_PARALLAX
    assert all(refused(degrees, still) is Verdict.PURE_ROTATION for degrees in (2, 5, 20))
    for length in (0.003, 0.01, 0.03, 0.1):
        for degrees in (0, 0.3, 30 * length):  # a wall is the scene that a rotation explains best
            assert refused(degrees, (length, 0.0, 0.0)) is Verdict.LOW_PARALLAX
            assert refused(degrees, (0.0, 0.0, length)) is Verdict.LOW_PARALLAX


def test_a_rotation_that_the_views_of_the_window_do_not_favour_is_not_said():
    window = make_window_evidence(0.3)
    assert refused(10, (0.0, 0.0, 0.0), window=replace(window, risk_rotation=0.9)) is Verdict.PURE_ROTATION
    assert refused(10, (0.0, 0.0, 0.0), window=replace(window, risk_rotation=0.1)) is Verdict.LOW_PARALLAX
