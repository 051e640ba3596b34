"""Laws of the rule "window": the stated risk of the joint fit decides, and nothing else."""

import json
from dataclasses import replace

import jsonschema
import pytest
from make_pair import preview_of
from make_scene import history_of
from make_summary import summarize
from make_window import WINDOW_CONFIG, point_source, pose_errors_deg, true_motion

from slam_init.attempt import try_pair
from slam_init.config import Config, load_config
from slam_init.errors import ConfigError
from slam_init.initializer import Initializer
from slam_init.methods import make_initializer
from slam_init.output.summary import summary_schema, summary_text
from slam_init.types.gates import GateName, Stage
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.stopwatch import Stopwatch


def finished(source, config=WINDOW_CONFIG, initializer=None):
    """The result after the tracks of a source, up to the map."""
    initializer = initializer or Initializer(source.camera, config)
    for observed in source.observations():
        if initializer.process_tracks(observed):
            break
    return initializer.finish()


def tried(source, views, config=WINDOW_CONFIG):
    """The outcome of an attempt on the first and the last of some frames."""
    observations = list(source.observations())
    seen = [observations[k] for k in views]
    preview = preview_of(seen, source.camera)
    return try_pair(source.camera, config, history_of(seen), preview, seen[-1], Stopwatch())


def with_limits(**limits):
    return replace(WINDOW_CONFIG, acceptance=replace(WINDOW_CONFIG.acceptance, **limits))


def errors_deg(source, map_):
    """Errors of the motion of the first two keyframes of a map."""
    first, second = map_.keyframes[:2]
    found = second.world_from_cam.inverse() @ first.world_from_cam
    return pose_errors_deg(found, true_motion(source, first.frame, second.frame))


# -- worlds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(1, 3))
@pytest.mark.parametrize(("scene", "baseline"), [("room", 0.1), ("room", 0.3), ("wall", 0.3), ("nadir", 0.2)])
def test_a_translating_camera_is_initialized_correctly(scene, baseline, seed):
    source = point_source(scene, seed, baseline=baseline)
    result = finished(source)
    assert result, result.reason
    rotation, direction = errors_deg(source, result.map)
    assert rotation < 5
    assert direction < 15
    assert result.hypotheses == (result.map,)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("scene", "options"),
    [("rotation", {}), ("rotation", {"focal_error": 0.05}), ("rotation", {"focal_error": -0.05}), ("static", {})],
)
def test_a_camera_that_does_not_translate_is_never_initialized(scene, options, seed):
    result = finished(point_source(scene, seed, **options))
    assert not result
    assert result.map is None


def test_the_same_tracks_give_the_same_map():
    a, b = (finished(point_source("wall", 2, baseline=0.3)).map for _ in range(2))
    assert [k.frame for k in a.keyframes] == [k.frame for k in b.keyframes]
    assert (a.points == b.points).all()


# -- evidence and gates ---------------------------------------------------------------------------


@pytest.mark.parametrize("scene", ["room", "wall"])
def test_each_attempt_with_a_motion_has_its_window_and_one_gate_on_the_risk(scene):
    result = finished(point_source(scene, 2, baseline=0.3))
    judged = [attempt for attempt in result.attempts if attempt.window is not None]
    assert judged
    for attempt in judged:
        (gate,) = (gate for gate in attempt.gates if gate.name == GateName.RISK)
        assert gate.value == attempt.window.risk
        assert gate.passes() == (attempt.window.risk <= WINDOW_CONFIG.acceptance.max_risk)
        window = attempt.window
        terms = window.risk_direction + window.risk_rival + window.risk_rotation + window.risk_floor
        assert window.risk == pytest.approx(min(1.0, terms))
        assert 2 <= window.views <= 12
        assert window.hypotheses >= 1
        assert window.focal_factor == pytest.approx(1, abs=0.1)
    last = result.attempts[-1]
    assert (last.verdict, last.stage, last.progress) == (Verdict.ACCEPTED, None, 1.0)
    assert last.window.planar == (scene == "wall")
    assert {gate.name for gate in last.gates if gate.name != GateName.MATCHES} >= {GateName.RISK, GateName.LANDMARKS}
    assert last.vote is None  # no other gate decides


def test_without_the_rule_there_is_no_window():
    assert all(attempt.window is None for attempt in finished(point_source("room", 0), Config()).attempts)


def test_the_largest_risk_is_an_option():
    source = point_source("room", 1)
    strict = tried(source, range(12), with_limits(max_risk=1e-4))  # below the floor of any risk
    assert strict.accepted is None
    assert strict.attempt.stage is Stage.MAP
    assert [gate.name for gate in strict.attempt.failed_gates] == [GateName.RISK]
    assert tried(source, range(12)).accepted is not None


def test_a_map_of_too_few_landmarks_is_refused_although_its_motion_is_right():
    outcome = tried(point_source("room", 1), range(12), with_limits(min_landmarks=1000))
    assert outcome.attempt.verdict == Verdict.TOO_FEW_LANDMARKS
    assert [gate.name for gate in outcome.attempt.failed_gates] == [GateName.LANDMARKS]
    assert outcome.accepted is None


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_an_ambiguous_plane_keeps_two_maps_and_one_of_them_is_right(seed):
    source = point_source("wall", seed, baseline=0.3)
    outcome = tried(source, (0, 11))
    assert (outcome.attempt.verdict, outcome.attempt.stage) == (Verdict.AMBIGUOUS_PLANE, Stage.MAP)
    assert outcome.accepted is None
    assert len(outcome.hypotheses) == 2
    errors = [errors_deg(source, map_)[1] for map_ in outcome.hypotheses]
    assert min(errors) < 10
    motions = [m.keyframes[1].world_from_cam.inverse() for m in outcome.hypotheses]
    assert pose_errors_deg(*motions)[1] > 2


def test_an_initializer_that_ends_undecided_returns_both_maps():
    observations = list(point_source("wall", 0, baseline=0.3).observations())
    initializer = Initializer(point_source("wall", 0).camera, WINDOW_CONFIG)
    for observed in (observations[0], observations[-1]):
        initializer.process_tracks(observed)
    result = initializer.finish()
    assert result.reason == Verdict.AMBIGUOUS_PLANE
    assert len(result.hypotheses) == 2
    assert all(isinstance(m.keyframes[0].world_from_cam, Pose) for m in result.hypotheses)
    validate(result)


def test_two_motions_of_a_room_are_low_parallax_and_leave_no_map():
    outcome = tried(point_source("room", 3, baseline=0.1), (0, 1))
    assert outcome.attempt.window.hypotheses > 1
    assert not outcome.attempt.window.planar
    assert outcome.attempt.verdict == Verdict.LOW_PARALLAX
    assert "two motions" in outcome.attempt.advice
    assert outcome.hypotheses == ()


def test_a_pair_with_an_uncertain_direction_is_low_parallax():
    outcome = tried(point_source("room", 0, baseline=0.1), (0, 1))
    window = outcome.attempt.window
    assert window.risk_direction > max(window.risk_rival, window.risk_rotation)
    assert outcome.attempt.verdict == Verdict.LOW_PARALLAX
    assert outcome.hypotheses == ()


# -- configuration and output ---------------------------------------------------------------------


def test_another_rule_is_refused_in_one_line(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text('[acceptance]\nrule = "windows"\n')
    with pytest.raises(ConfigError, match=r"acceptance\.rule is 'windows': use gates or window") as refusal:
        load_config(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("rule", ["gates", "window"])
def test_a_rule_is_read_from_a_file(tmp_path, rule):
    path = tmp_path / "c.toml"
    path.write_text(f'[acceptance]\nrule = "{rule}"\n')
    assert load_config(path).acceptance.rule == rule


def test_the_method_quest_window_is_the_rule():
    source = point_source("room", 2)
    by_rule = finished(source)
    by_method = finished(source, initializer=make_initializer("quest-window", source.camera, Config()))
    assert (by_method.map.points == by_rule.map.points).all()
    assert by_method.attempts[-1].window == by_rule.attempts[-1].window


def validate(result):
    content = json.loads(summary_text(summarize(result)))
    jsonschema.Draft202012Validator(summary_schema()).validate(content)
    return content


@pytest.mark.parametrize(("scene", "baseline"), [("room", 0.2), ("wall", 0.3), ("rotation", 0.0)])
def test_the_summary_is_valid_and_holds_the_window_of_each_attempt(scene, baseline):
    result = finished(point_source(scene, 2, baseline=baseline))
    content = validate(result)
    windows = [attempt["window"] for attempt in content["attempts"]]
    for window, attempt in zip(windows, result.attempts, strict=True):
        assert (window is None) == (attempt.window is None)
        if window is not None:
            assert window["risk"] == pytest.approx(attempt.window.risk, rel=1e-4)
