"""Laws of the refusal of all pairs of a frame by their previews."""

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, observe

from slam_init.decision.screening import screen
from slam_init.frontend.keyframes import PairPreview
from slam_init.types.refusal import GateName, Stage, Verdict

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
