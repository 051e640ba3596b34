"""Laws of the check of the stated focal length of a rotating camera."""

from dataclasses import replace

import numpy as np
import pytest
from make_pair import preview_of
from make_scene import CAMERA, CONFIG, cloud, history_of, observe

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.decision.focal_check import FocalCheck, with_focal_check
from slam_init.types.evidence import RotationOnlyEvidence
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

ROTATED = Attempt((0, 1), Verdict.PURE_ROTATION)


def rotating(degrees, factor=1.0):
    """A frame for each angle about the vertical axis, with the bearings of a camera whose focal length is wrong."""
    poses = [Pose(rotation_from_vector(np.array([0.0, np.deg2rad(angle), 0.0])), np.zeros(3)) for angle in degrees]
    rng = np.random.default_rng(0)
    seen = observe(CAMERA, poses, cloud(rng, 400), 0.3, rng)
    stated = camera_with_focal_factor(CAMERA, 1 / factor)
    return stated, [replace(view, bearings=stated.bearings(view.pixels)) for view in seen]


@pytest.mark.parametrize("factor", [0.94, 1.06])
def test_a_wrong_focal_length_is_suspected(factor):
    stated, seen = rotating([0, 10], factor)
    checked = with_focal_check(stated, CONFIG, ROTATED, *seen)
    assert checked.suspected_focal_factor == pytest.approx(factor, abs=0.015)
    assert checked.verdict == Verdict.PURE_ROTATION


def test_a_right_focal_length_is_not_suspected():
    stated, seen = rotating([0, 10])
    checked = with_focal_check(stated, CONFIG, ROTATED, *seen)
    assert checked.rotation_only is not None
    assert checked.suspected_focal_factor is None


def test_a_check_is_made_when_the_rotation_has_clearly_grown():
    degrees = [0, 3, 7, 7.5, 16]
    stated, seen = rotating(degrees, 1.06)
    history, check = history_of(seen, stated), FocalCheck(CONFIG)
    done = []
    for current, angle in zip(seen[1:], degrees[1:], strict=True):
        pairs = [preview_of([seen[0], current], stated)]
        if check(ROTATED, pairs, history, current).rotation_only is not None:
            done.append(angle)
    assert 1.02 < CONFIG.keyframes.retry_gain < 2
    assert done == [7, 16]


def test_the_pair_with_the_largest_rotation_is_checked():
    stated, seen = rotating([0, 8, 16], 1.06)
    pairs = [preview_of([seen[1], seen[2]], stated), preview_of([seen[0], seen[2]], stated)]
    checked = FocalCheck(CONFIG)(ROTATED, pairs, history_of(seen, stated), seen[2])
    assert checked.rotation_only == with_focal_check(stated, CONFIG, ROTATED, seen[0], seen[2]).rotation_only


def test_only_an_unchecked_pure_rotation_is_checked():
    stated, seen = rotating([0, 16], 1.06)
    pairs, history = [preview_of(seen, stated)], history_of(seen, stated)
    for attempt in (
        Attempt((0, 1), Verdict.LOW_PARALLAX),
        replace(ROTATED, rotation_only=RotationOnlyEvidence(1.0)),
    ):
        assert FocalCheck(CONFIG)(attempt, pairs, history, seen[1]) is attempt
