"""A rotation-only camera with a wrong stated focal length is distinguished from a translation in front of a wall."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import make_window_evidence
from make_pair import preview_of
from make_scene import CAMERA, CONFIG, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.rotation_only import (
    RotationOnlyCamera,
    fit_rotation_only,
    rotation_only_evidence,
    suspected_focal_factor,
    with_established_reason,
)
from slam_init.decision.screening import preview_evidence
from slam_init.types.evidence import RotationOnlyEvidence
from slam_init.types.gates import GateName, at_most
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

NOISE = 1e-3
TURN = rotation_from_vector(np.array([0.03, 0.2, 0.01]))


def matches(R, t, factor=1.0, depth=None, seed=0, count=400):
    """Bearings under the stated calibration, of a camera with another focal length, and points at ``depth(x)``."""
    rng = np.random.default_rng(seed)
    x = np.column_stack([rng.uniform([-0.7, -0.5], [0.7, 0.5], (count, 2)), np.ones(count)])
    X = x * (1.0 if depth is None else depth(x)[:, None])
    views = []
    for Y in (X, X @ R.T + t):
        pixels = factor * Y[:, :2] / Y[:, 2:] + rng.normal(0, NOISE, (count, 2))
        views.append(np.column_stack([pixels, np.ones(count)]))
    return tuple(view / np.linalg.norm(view, axis=1, keepdims=True) for view in views)


def wall(x):
    return 1 / (x @ [0.2, 0.1, 0.8])


@pytest.mark.parametrize("factor", [0.92, 0.97, 1.0, 1.04, 1.08])
@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_the_fit_of_a_rotation_only_camera_leaves_the_noise_and_finds_the_focal_length(factor, outliers):
    m, n = matches(TURN, np.zeros(3), factor)
    lost = int(outliers * len(n))
    n[:lost] = matches(TURN, np.zeros(3), seed=9, count=lost)[1] if lost else n[:lost]
    found = fit_rotation_only(m, n, NOISE)
    assert found.focal_factor == pytest.approx(factor, abs=0.015)
    # Away from the optical axis, the noise of a bearing is less than that of a pixel. Outliers raise the median.
    assert 0.6 * NOISE < found.residual_rad < (1.8 if lost else 1.1) * NOISE
    assert found.gain >= 0


@pytest.mark.parametrize("seed", range(3))
def test_the_fit_to_a_translation_in_front_of_a_wall_leaves_more_than_noise(seed):
    t = 0.1 * np.random.default_rng(seed).normal(size=3)
    m, n = matches(TURN, t, depth=wall, seed=seed)
    found = fit_rotation_only(m, n, NOISE)
    assert found.residual_rad > 3 * NOISE
    assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_wrong_focal_length_is_suspected_and_a_right_one_is_not():
    for factor in (0.94, 1.06):
        found = fit_rotation_only(*matches(TURN, np.zeros(3), factor), NOISE)
        assert suspected_focal_factor(found, 1.5 * NOISE) == pytest.approx(factor, abs=0.015)
    for seed in range(5):
        found = fit_rotation_only(*matches(TURN, np.zeros(3), seed=seed), NOISE)
        assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_static_camera_does_not_determine_its_focal_length():
    found = fit_rotation_only(*matches(np.eye(3), np.zeros(3), 1.08), NOISE)
    assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_focal_length_is_suspected_only_if_all_conditions_hold():
    sure = RotationOnlyCamera(1.05, 1.0, matches=400, gain=100.0, gain_z=8.0)
    assert suspected_focal_factor(sure, 1.5) == 1.05
    assert suspected_focal_factor(replace(sure, focal_factor=0.98), 1.5) == 0.98
    for reason, weak in {
        "the rotation-only camera does not explain the matches": replace(sure, residual_rad=1.6),
        "the stated focal length explains the matches as well": replace(sure, gain=10.0),
        "the gain comes from one region of the view": replace(sure, gain_z=2.0),
        "the factor is within the error of a calibration": replace(sure, focal_factor=1.01),
        "the factor is the last one that was tried": replace(sure, focal_factor=1.1),
    }.items():
        assert suspected_focal_factor(weak, 1.5) is None, reason


def test_a_residual_of_few_matches_may_exceed_its_expectation_more():
    """Over many draws, the largest median length of Gaussian errors is near the factor."""
    rng = np.random.default_rng(0)
    for count in (50, 800):
        lengths = np.linalg.norm(rng.normal(size=(2000, count, 2)), axis=2)
        medians = np.median(lengths, axis=1) / np.sqrt(2 * np.log(2))
        limit = RotationOnlyCamera(1.0, 1.0, count, 0.0, 0.0).chance_factor
        assert 1 + 0.7 * (limit - 1) < medians.max() < 1 + 1.3 * (limit - 1)


def test_the_evidence_suspects_the_focal_length_within_noise_and_correlated_error():
    explains = RotationOnlyCamera(1.05, NOISE, matches=400, gain=100.0, gain_z=8.0)
    assert rotation_only_evidence(CAMERA, CONFIG, explains, NOISE) == RotationOnlyEvidence(1.05, 1.05)
    leaves = replace(explains, residual_rad=5 * NOISE)
    assert rotation_only_evidence(CAMERA, CONFIG, leaves, NOISE) == RotationOnlyEvidence(1.05, None)
    # Half a pixel of a lens that is calibrated carelessly is expected, whatever the noise of the tracks is.
    lens = replace(explains, residual_rad=0.45 / CAMERA.focal_px)
    assert rotation_only_evidence(CAMERA, CONFIG, lens, 0.1 / CAMERA.focal_px).suspected_focal_factor == 1.05


def refused(degrees, t, noise_px=0.2, window=None):
    """The reason of a pair before a frontal wall at the distance 1 that looks like a pure rotation."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform([-0.9, -0.7], [0.9, 0.7], (800, 2)), np.ones(800)])
    poses = [Pose.identity(), Pose(rotation_from_vector(np.array([0.0, np.radians(degrees), 0.0])), np.array(t))]
    seen = observe(CAMERA, poses, points, noise_px, rng)
    gate = at_most(GateName.RISK, 1.0, 0.005, Verdict.PURE_ROTATION)
    attempt = Attempt((0, 1), Verdict.PURE_ROTATION, gates=(gate,), preview=preview_evidence(preview_of(seen)))
    named = with_established_reason(CAMERA, CONFIG, replace(attempt, window=window))
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
    noisy = replace(window, noise_px=1.5 * CONFIG.two_view.threshold_px)
    assert refused(0, (0.1, 0.0, 0.0), window=noisy) is Verdict.NO_CONSISTENT_MOTION
