"""A camera only rotates where a rotation is established; a short translation is not called one."""

from dataclasses import replace

import numpy as np
from make_map import make_window_evidence
from make_pair import preview_of
from make_scene import CAMERA, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.two_views import with_established_reason
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Verdict, at_most
from slam_init.types.result import Attempt


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
