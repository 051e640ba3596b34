"""Laws of the rule of the window: the stated risk of the joint fit decides, and nothing else."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from make_map import bytes_of
from make_pair import preview_of
from make_scene import CAMERA, cloud, history_of, observe
from make_window import WINDOW_CONFIG, errors_deg, fed, finished, is_right, point_source, pose_errors_deg, true_motion

from slam_init.bundle.problem import BundleFailure
from slam_init.calibration.files import camera_with_focal
from slam_init.config import Config
from slam_init.datasets.synth import PointSource
from slam_init.decision import window_map, window_rule
from slam_init.decision.window_rule import WindowRule
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.initializer import Initializer
from slam_init.methods import make_initializer
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Stage, Verdict
from slam_init.types.stopwatch import Stopwatch
from slam_init.window.levels import WRONG_DIRECTION_DEG, WRONG_ROTATION_DEG

#: Worlds of :func:`followed`: rooms with little and with more parallax, and a plane.
WORLDS = [("room", 0, 0.03), ("room", 2, 0.1), ("wall", 0, 0.3)]
#: Fewer tracks than the default, where a law does not ask for more: the fits take as much less time.
FEWER = 150


def tried(source, views, config=WINDOW_CONFIG):
    """The outcome of the first and the last of some frames as the chosen pair."""
    observations = list(source.observations())
    seen = [observations[k] for k in views]
    preview = preview_of(seen, source.camera)
    rule = WindowRule(config, history_of(seen, source.camera), RollingShutter(source.camera))
    return rule.evaluate(preview, [preview], seen[-1], Stopwatch())


@dataclass(frozen=True)
class Followed:
    """A run up to its map."""

    source: PointSource
    initializer: Initializer
    #: Each frame with its status and the provisional map, asked twice.
    steps: list[tuple]
    #: Frames of each window whose risk was asked for, and the risk of the direction of each view.
    evaluated: list[tuple]


@cache
def followed(scene, seed, baseline):
    """A run that several laws read."""
    source = point_source(scene, seed, baseline=baseline, points=300 if scene == "room" else FEWER)
    evaluated, risk_of = [], window_rule.risk_of

    def noting_risk_of(hypotheses, max_risk):
        risk = risk_of(hypotheses, max_risk)
        evaluated.append((hypotheses.motions[0].frames, risk.directions.of_views))
        return risk

    initializer, steps = Initializer(source.camera, WINDOW_CONFIG), []
    assert initializer.provisional is None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_rule, "risk_of", noting_risk_of)
        for observed in source.observations():
            status = initializer.process_tracks(observed)
            steps.append((observed, status, initializer.provisional, initializer.provisional))
            if status:
                break
    return Followed(source, initializer, steps, evaluated)


def with_limits(**limits):
    return replace(WINDOW_CONFIG, acceptance=replace(WINDOW_CONFIG.acceptance, **limits))


# -- worlds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", WORLDS)
def test_a_translating_camera_is_initialized_correctly(world):
    result = followed(*world).initializer.finish()
    assert result, result.reason
    assert is_right(followed(*world).source, result.map)
    assert result.hypotheses == (result.map,)


@pytest.mark.parametrize(
    ("scene", "seed", "options"),
    [
        ("rotation", 0, {}),
        ("rotation", 1, {"focal_error": 0.05}),
        ("static", 0, {}),
        # The other tracks are at infinity: the moving objects look like near objects before a translating camera.
        ("rotation", 71002, {"moving": 0.3, "noise_px": 1.0, "outliers": 0.3}),
        ("static", 71003, {"moving": 0.3, "noise_px": 1.0, "outliers": 0.05}),
    ],
)
def test_a_camera_that_does_not_translate_is_never_initialized(scene, seed, options):
    result = finished(point_source(scene, seed, **options))
    assert not result
    assert result.map is None


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "noise_px"), [(365010, 0.3), (365029, 0.6)])
def test_a_few_tracks_on_moving_objects_do_not_decide_between_the_motions_of_a_plane(seed, noise_px):
    """Both walls had a map with the wrong motion, by the votes of 22 and of 53 tracks off the plane."""
    source = point_source("wall", seed, moving=0.3, noise_px=noise_px, outliers=0.2)
    result = finished(source)
    if result:  # the whole sequence may tell
        rotation, direction = errors_deg(source, result.map)
        assert rotation < 0.5 and direction < 5.0


# -- evidence and gates ---------------------------------------------------------------------------


@pytest.mark.parametrize("world", WORLDS[1:])
def test_each_attempt_with_a_motion_has_its_window_and_one_gate_on_the_risk(world):
    scene, result = world[0], followed(*world).initializer.finish()
    evaluated = [attempt for attempt in result.attempts if attempt.window is not None]
    assert [attempt.frames[1] for attempt in result.attempts] == list(range(1, len(result.attempts) + 1))
    assert evaluated == list(result.attempts) if scene == "wall" else evaluated
    for attempt in evaluated:
        (gate,) = (gate for gate in attempt.gates if gate.name == GateName.RISK)
        assert gate.value == attempt.window.risk
        assert gate.passes() == (attempt.window.risk <= WINDOW_CONFIG.acceptance.max_risk)
        window = attempt.window
        names = ("direction", "competing", "rotation", "moving", "floor")
        terms = sum(getattr(window, f"risk_{name}") for name in names)
        # A map adds what bundle adjustment moved it to the term of the direction.
        assert window.risk == pytest.approx(min(1.0, terms))
        assert 2 <= window.views <= 12
        assert window.hypotheses >= 1
        assert window.focal_factor == pytest.approx(1, abs=0.1)
        assert 0 < window.depth_sigma < np.inf
        assert window.noise_px == pytest.approx(0.7, rel=0.15)  # of the simulated worlds
        assert 0 <= window.correlated_px <= 2
    last = result.attempts[-1]
    assert (last.verdict, last.stage, last.progress) == (Verdict.ACCEPTED, None, 1.0)
    assert last.window.planar == (scene == "wall")
    assert result.map.scene == ("planar" if scene == "wall" else "general")
    assert {gate.name for gate in last.gates if gate.name != GateName.MATCHES} >= {GateName.RISK, GateName.LANDMARKS}


def test_the_largest_risk_is_an_option():
    source, views = point_source("wall", 1, baseline=0.1, points=FEWER), range(5)
    strict = tried(source, views)
    assert strict.accepted is None
    assert strict.attempt.stage is Stage.MAP
    assert [gate.name for gate in strict.attempt.failed_gates] == [GateName.RISK]
    assert tried(source, views, with_limits(max_risk=1.0)).accepted is not None


def test_a_map_of_too_few_landmarks_is_refused_although_its_motion_is_right():
    outcome = tried(point_source("room", 1, points=FEWER), range(6), with_limits(min_landmarks=1000))
    assert outcome.attempt.verdict == Verdict.TOO_FEW_LANDMARKS
    assert [gate.name for gate in outcome.attempt.failed_gates] == [GateName.LANDMARKS]
    assert outcome.accepted is None


def test_a_pair_with_an_uncertain_direction_is_low_parallax():
    outcome = tried(point_source("wall", 16, baseline=0.08), (0, 2))
    window = outcome.attempt.window
    assert window.risk_direction > max(window.risk_competing, window.risk_rotation)
    assert outcome.attempt.verdict == Verdict.LOW_PARALLAX
    assert outcome.undecided is None


# -- keyframes of the map -------------------------------------------------------------------------


@pytest.mark.parametrize("world", WORLDS)
def test_the_keyframes_are_the_pair_and_the_views_whose_own_baseline_is_certain(world):
    result = followed(*world).initializer.finish()
    (reference, current, *others), (_, *risks) = followed(*world).evaluated[-1]
    limit = 5e-4  # the floor of the risk
    certain = [frame for frame, risk in zip(others, risks, strict=True) if risk <= limit]
    keyframes = [k.frame for k in result.map.keyframes]
    # A certain view that sees too few of the landmarks is left out.
    assert {reference, current} <= set(keyframes) <= {reference, current, *certain}
    assert len(keyframes) >= 1 + len(certain)
    assert (len(certain) < len(others)) == (world == WORLDS[0])  # its first views are too near


def test_a_view_that_sees_too_few_of_the_landmarks_is_left_out_and_does_not_prevent_the_map(monkeypatch):
    source, whole = followed("room", 2, 0.1).source, followed("room", 2, 0.1).initializer.map
    blind = whole.keyframes[1].frame  # neither the reference nor the current frame

    def map_of_poses(camera, config, table, *arguments):
        if blind in table.frames:
            return BundleFailure(f"frame {blind} sees only 1 landmarks after the removal of outliers", blind)
        return build(camera, config, table, *arguments)

    build = window_map.map_of_poses
    monkeypatch.setattr(window_map, "map_of_poses", map_of_poses)
    kept = [keyframe.frame for keyframe in finished(source).map.keyframes]
    assert kept == [keyframe.frame for keyframe in whole.keyframes if keyframe.frame != blind]


def test_of_the_frames_before_the_camera_moves_the_map_has_the_reference_only():
    poses = [Pose.identity()] * 4 + [Pose(np.eye(3), 0.1 * k * np.array([1.0, 0.2, 0.1])) for k in range(1, 6)]
    rng = np.random.default_rng(0)
    initializer = fed(Initializer(CAMERA, WINDOW_CONFIG), observe(CAMERA, poses, cloud(rng, 300), 0.3, rng))
    frames = [k.frame for k in initializer.map.keyframes]
    assert len([frame for frame in frames if frame < 4]) == 1
    assert frames[-1] >= 4


# -- the provisional map --------------------------------------------------------------------------


@pytest.mark.parametrize("world", WORLDS)
def test_the_provisional_map_is_none_then_too_risky_then_the_accepted_map(world):
    initializer = followed(*world).initializer
    *before, (_, accepting, accepted, _) = followed(*world).steps
    waiting = 0
    for observed, status, provisional, _ in before:
        assert (provisional is None) == (status.attempt is None or status.attempt.window is None)
        if provisional is not None:
            assert provisional.map.model_risk >= status.attempt.window.risk
            assert len(provisional.map.points)
            assert max(k.frame for k in provisional.map.keyframes) == observed.frame
            waiting += 1
    assert accepting
    assert waiting
    assert accepted.map is initializer.map is not None
    assert accepted.map.model_risk == accepting.attempt.window.risk <= WINDOW_CONFIG.acceptance.max_risk
    assert initializer.provisional.map is initializer.finish().map


def test_the_provisional_map_can_be_asked_for_after_its_frames_are_dropped():
    source = point_source("wall", 0, baseline=0.3)
    observations = list(source.observations())
    initializer = Initializer(source.camera, WINDOW_CONFIG)
    for observed in observations[:3]:
        assert not initializer.process_tracks(observed)
    assert initializer.provisional is not None
    few = observations[3].at(np.arange(5))
    for k in range(3, 250):
        initializer.process_tracks(replace(few, frame=k, timestamp_s=k / 10))
    assert len(initializer.history) < 200
    provisional = initializer.provisional
    assert provisional.map.model_risk > WINDOW_CONFIG.acceptance.max_risk


def test_asking_for_the_provisional_map_does_not_change_the_result():
    run = followed("wall", 0, 0.3)
    asked, unasked = run.initializer.finish(), finished(run.source)
    known = [(once, twice) for _, _, once, twice in run.steps if once is not None]
    assert len(known) > 1
    assert all(bytes_of(once.map) == bytes_of(twice.map) for once, twice in known)
    assert bytes_of(asked.map) == bytes_of(unasked.map)
    assert [(a.frames, a.gates, a.window) for a in asked.attempts] == [
        (a.frames, a.gates, a.window) for a in unasked.attempts
    ]


# -- configuration and output ---------------------------------------------------------------------


def test_without_a_third_view_the_window_holds_the_pair_alone():
    source = point_source("room", 2)
    result = fed(make_initializer("quest-two-view", source.camera, Config()), source.observations()).finish()
    assert result, result.reason
    evaluated = [attempt for attempt in result.attempts if attempt.stage is not Stage.MOTION]
    assert {attempt.window.views for attempt in evaluated} == {2}
    assert all(attempt.two_view is not None for attempt in evaluated)  # no motion of an earlier pair is evaluated
    assert len(result.map.keyframes) == 2
    assert is_right(source, result.map)
    by_keyword = fed(Initializer(source.camera, third_view=False), source.observations())
    assert bytes_of(by_keyword.map) == bytes_of(result.map)


@pytest.mark.slow
def test_the_inliers_of_an_accepted_pair_are_those_of_its_map_where_the_lens_was_unknown(room):
    """The pair is shown with the mask of the motion and the lens that were accepted, not of the lens before."""
    initializer = Initializer(camera_with_focal((640, 480), 1.4 * room.camera.fx, 0.35, "prior"))
    for frame in room.frames():
        if initializer.process(frame):
            break
    attempt, map_ = initializer.status.attempt, initializer.map
    assert map_ is not None and map_.camera.source == "estimated"
    assert attempt.inliers.sum() >= 0.9 * len(map_.points)


@pytest.mark.slow
def test_the_maps_of_the_scene_and_of_a_large_moving_object_are_kept_and_one_of_them_is_right():
    source = point_source("room", 4, moving=0.6, objects=1, baseline=0.2)
    result = finished(source)
    assert (result.reason, result.map, len(result.hypotheses)) == (Verdict.MOVING_OBJECTS, None, 2)
    moving = [np.mean(source.sequence.is_moving[one.track_ids]) for one in result.hypotheses]
    assert max(moving) > 0.9
    assert min(moving) < 0.1
    at_rest = result.hypotheses[int(np.argmin(moving))]
    first, last = at_rest.keyframes[0], max(at_rest.keyframes, key=lambda one: one.frame)
    found = last.world_from_cam.inverse() @ first.world_from_cam
    rotation_deg, direction_deg = pose_errors_deg(found, true_motion(source, first.frame, last.frame))
    assert rotation_deg < WRONG_ROTATION_DEG
    assert direction_deg < WRONG_DIRECTION_DEG
