"""The length of a trial, and the row of a trial that found no map."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from slam_init.compare.sources import describe_sources, open_compared
from slam_init.compare.trials import Settings, Trial, result_row
from slam_init.types.evidence import RotationOnlyEvidence
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, Result


def test_a_trial_on_video_ends_after_five_seconds_and_one_on_photographs_after_the_limit_of_frames():
    (source,) = describe_sources(["points:room?views=400"])
    assert Settings().frames_limit(source, 0) == 50
    assert Settings().frames_limit(replace(source, fps=1.0), 0) == 150
    assert Settings().frames_limit(source, 390) == 10


def test_an_ambiguous_plane_is_kept_correctly_if_one_of_the_hypotheses_is_correct():
    """One hypothesis is the truth and one is rotated by 30 degrees; their order does not matter."""
    (source,) = describe_sources(["points:wall?seed=2"])
    trial, opened = Trial(source, "quest", 0), open_compared(source.text)
    truth = [opened.groundtruth.world_from_cam[frame] for frame in (0, 8)]
    rotation = Pose.from_quaternion(np.array([np.cos(0.26), 0.0, np.sin(0.26), 0.0]), np.zeros(3))
    first, second = (Keyframe(f, 0.1 * f, "", truth[0].inverse() @ pose) for f, pose in zip((0, 8), truth, strict=True))
    right = SimpleNamespace(keyframes=(first, second))
    wrong = SimpleNamespace(keyframes=(first, replace(second, world_from_cam=second.world_from_cam @ rotation)))

    def kept_truth(*maps, reason=Verdict.AMBIGUOUS_PLANE):
        result = Result(None, reason, 12, None, (), {}, hypotheses=maps)
        return result_row(trial, Settings(), result, opened, ()).kept_truth

    assert kept_truth(right, wrong) is kept_truth(wrong, right) is True
    assert kept_truth(wrong, wrong) is kept_truth() is False
    assert kept_truth(right, wrong, reason=Verdict.LOW_PARALLAX) is None


def test_one_suspicion_of_the_focal_length_is_recorded_and_several_that_agree_are_reported():
    (source,) = describe_sources(["points:rotation?focal_error=0.05"])
    trial, opened = Trial(source, "quest", 0), open_compared(source.text)

    def factors(*suspected):
        attempts = tuple(
            Attempt((0, k), Verdict.PURE_ROTATION, rotation_only=RotationOnlyEvidence(factor, factor))
            for k, factor in enumerate(suspected)
        )
        result = Result(None, Verdict.PURE_ROTATION, 12, None, attempts, {})
        row = result_row(trial, Settings(), result, opened, ())
        return row.suspected_focal_factor, row.reported_focal_factor

    assert factors() == (None, None)
    assert factors(0.96) == (0.96, None)
    assert factors(0.95, 0.95, 0.96) == (0.95, 0.95)
