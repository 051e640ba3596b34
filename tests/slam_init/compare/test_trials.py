"""The length of a trial, and the row of a trial that found no map."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from make_map import make_attempts, make_map, make_result, make_truth

from quest.geometry.quaternion import rotation_from_vector
from slam_init.compare.figures import figures_of, table_of
from slam_init.compare.sources import describe_sources, open_compared
from slam_init.compare.trials import Plan, Settings, Trial, result_row, run_trial
from slam_init.output.results import tum_text
from slam_init.types.evidence import FreeFocal
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict
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


def test_the_map_of_any_method_is_audited_where_it_is_asked_for():
    (source,) = describe_sources(["points:room?baseline=0.1"])
    trial = Trial(source, "essential-5pt", 0)
    without, row = (run_trial(trial, Settings(audit=audit)) for audit in (False, True))
    assert row.outcome == "correct" and row.risk is without.audited_risk is None
    assert 0 < row.audited_risk < 0.05
    assert figures_of(table_of([row]))["audited_risk"] == row.audited_risk
    assert figures_of(table_of([without]))["audited_risk"] is None


def test_one_suspicion_of_the_focal_length_is_recorded_several_that_agree_are_reported_and_both_are_counted():
    def row_of(text, *suspected):
        (source,) = describe_sources([text])
        evidence = [FreeFocal(1.0, factor, 0.01, factor < 1) for factor in suspected]
        attempts = tuple(Attempt((0, k), Verdict.PURE_ROTATION, free_focal=one) for k, one in enumerate(evidence))
        named = evidence[0] if len(evidence) > 1 else None
        result = Result(None, Verdict.PURE_ROTATION, 12, None, attempts, {}, wrong_focal=named)
        return result_row(Trial(source, "quest", 0), Settings(), result, open_compared(text), ())

    wrong, right = "points:rotation?focal_error=0.05", "points:rotation"
    rows = [row_of(wrong, 1.0), row_of(wrong, 0.96), row_of(wrong, 0.95, 0.95, 0.96), row_of(right, 0.95, 0.95)]
    factors = [(row.suspected_focal_factor, row.reported_focal_factor) for row in rows]
    assert factors == [(None, None), (0.96, None), (0.95, 0.95), (0.95, 0.95)]
    figures = figures_of(table_of(rows))
    shares = [figures[name].value for name in ("suspicion_rate", "report_rate", "false_report_rate")]
    assert [round(share, 2) for share in shares] == [0.67, 0.33, 1.0]


def test_the_row_of_a_map_holds_what_the_accepted_attempt_states_and_the_errors_of_its_pair():
    """The truth of the last keyframe is rotated by 6 degrees, so that the map is false and its pair is exact."""
    map_ = make_map()
    truth = make_truth(map_)
    *poses, last = truth.world_from_cam
    turned = Pose(last.R @ rotation_from_vector(np.radians([0.0, 6.0, 0.0])), last.t)
    source = SimpleNamespace(groundtruth=replace(truth, world_from_cam=(*poses, turned)), timestamps_s=np.arange(99.0))
    (described,) = describe_sources(["points:room"])
    trial = Trial(described, "quest", 0)
    first, second, third, _ = (keyframe.frame for keyframe in map_.keyframes)

    def row_of(attempt):
        result = replace(make_result(map_), attempts=(*make_attempts(map_)[:-1], attempt))
        return result_row(trial, Settings(), result, source, ())

    accepted = replace(make_attempts(map_)[-1], frames=(first, third, second))
    row = row_of(accepted)
    assert row.outcome == "false"
    assert (row.risk, row.rotation_sigma_deg, row.direction_sigma_deg) == (0.004, 0.1, 4.0)
    assert row.rotation_error_deg == pytest.approx(6.0)
    assert max(row.pair_rotation_error_deg, row.pair_direction_error_deg) < 1e-4
    unbounded = replace(accepted.window, rotation_sigma_deg=np.inf)
    assert row_of(replace(accepted, window=unbounded)).rotation_sigma_deg is None

    without = row_of(replace(accepted, window=None))
    assert without.outcome == "false"
    assert without.risk is without.rotation_sigma_deg is without.pair_rotation_error_deg is None


def test_an_external_program_is_evaluated_by_its_poses_and_is_left_out_on_points(tmp_path):
    images, points = describe_sources(["synth:room?frames=3&width=64&height=64", "points:room"])
    truth = open_compared(images.text).groundtruth
    stamped = zip(truth.timestamps_s.tolist(), truth.world_from_cam, strict=True)
    (tmp_path / "true.txt").write_text(tum_text([Keyframe(i, t, "", pose) for i, (t, pose) in enumerate(stamped)]))
    code = f"import shutil, sys; shutil.copy({str(tmp_path / 'true.txt')!r}, sys.argv[2] + '/trajectory.txt')"
    method = f'copies=command:{sys.executable} -c "{code}" {{images}} {{out}}'
    row = run_trial(Trial(images, method, 0), Settings())
    assert (row.outcome, row.frames_to_accept, row.landmarks) == ("correct", 3, None)
    plan = Plan((images, points), ("stella", method))
    assert [plan.methods_on(source) for source in plan.sources] == [("stella", method), ("stella",)]
