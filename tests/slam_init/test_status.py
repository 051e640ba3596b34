"""Frame by frame: what an initializer takes, what it tells, what it keeps, and that it shares nothing."""

from dataclasses import replace
from itertools import zip_longest

import numpy as np
import pytest
from make_map import make_map, make_poses
from make_scene import CAMERA, CONFIG, cloud, observe, plane
from make_source import GivenFrames

from quest.geometry.quaternion import rotation_from_vector
from slam_init.attempt_log import ATTEMPTS_KEPT, AttemptLog, focal_notes
from slam_init.compare.measures import pose_errors
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.methods import make_initializer
from slam_init.output.results import summary_dict
from slam_init.recording.recorder import Recorder
from slam_init.status import Status, frame_of, progress
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.reasons import ACCEPTED, REASONS, Gate
from slam_init.types.result import Attempt

#: Straight towards a plane: its twin explains all views of that.
STRAIGHT = [Pose(np.eye(3), k * np.array([0.02, 0.0, 0.06])) for k in range(5)]
#: Then in a curve, for long enough to be tried again.
CURVE = [
    Pose(rotation_from_vector(np.array([0.015, -0.025, 0.0]) * k), STRAIGHT[4].t + np.array([0.04, 0.025, -0.01]) * k)
    for k in range(1, 16)
]


def planar_views(poses, seed=2, noise_px=0.5):
    rng = np.random.default_rng(seed)
    return observe(CAMERA, poses, plane(rng, 300), noise_px, rng)


def seen_from(poses, noise_px=0.3, count=300):
    return observe(CAMERA, poses, cloud(np.random.default_rng(0), count), noise_px, np.random.default_rng(1))


def shape_of(map_):
    """What a map is made of, as bytes."""
    poses = [np.concatenate([k.world_from_cam.R.ravel(), k.world_from_cam.t]).tobytes() for k in map_.keyframes]
    return [k.frame for k in map_.keyframes], poses, map_.points.tobytes(), map_.pose_covariances.tobytes()


# -- the status -----------------------------------------------------------------------------------


def test_the_status_begins_at_zero_and_ends_at_one():
    initializer = Initializer(CAMERA)
    assert (initializer.status.state, initializer.status.progress) == ("waiting", 0.0)
    told = [initializer.process_tracks(observed) for observed in seen_from(make_poses(8))]
    assert told[0].progress == 0
    assert not told[0]
    assert told[0].attempt is None
    last = told[-1]
    assert last
    assert (last.state, last.progress, last.reason, last.advice) == ("initialized", 1.0, None, "")
    assert initializer.status is last
    for status in told:
        assert bool(status) == (status.state == "initialized") == (status.progress == 1)
        if not status:
            assert 0 <= status.progress < 1
            assert status.reason in REASONS
            assert status.advice


def test_a_camera_that_stands_still_is_told_so_and_gets_nowhere():
    initializer = Initializer(CAMERA)
    for observed in seen_from([Pose.identity()] * 5, noise_px=0.1):
        status = initializer.process_tracks(observed)
    assert (status.state, status.reason) == ("waiting", "static_camera")
    assert "stands still" in status.advice
    assert status.progress < 0.5
    failed = next(gate for gate in status.attempt.gates if not gate.passes())
    assert (failed.name, failed.reason, failed.advice) == ("motion_px", "static_camera", status.advice)
    assert status.attempt.progress == progress("motion", [g for g in status.attempt.gates if not g.passes()])


def test_a_later_stage_is_further_and_within_a_stage_the_worst_gate_counts():
    half = Gate("x", 1.0, 2.0, True, "low_parallax", "move")
    whole = Gate("y", 3.0, 2.0, True, "low_parallax", "move")
    assert progress("motion", [half, whole]) == (1 + 0.5) / 4
    assert progress("matches", [whole]) <= progress("motion") < progress("motion", [half]) < progress("two views")
    assert progress("map", [half]) < 1


def test_the_progress_is_that_of_the_best_reference_and_falls_with_it():
    initializer = Initializer(CAMERA)
    views = planar_views(STRAIGHT)
    for observed in views:
        far = initializer.process_tracks(observed).progress
    assert far > 0.75
    # Another scene: what was known is of no use, and its frames are given up one by one.
    elsewhere = seen_from([Pose.identity()] * 400, noise_px=0.1, count=60)
    for k, observed in enumerate(elsewhere[: 10 * (CONFIG.keyframes.window + 3)]):
        away = replace(observed, frame=10 + k, track_ids=observed.track_ids + 100_000)
        status = initializer.process_tracks(away)
    assert status.progress < 0.5


def test_reason_and_advice_stay_where_nothing_was_tried():
    refused = Attempt((0, 1), "low_parallax", {}, "keep translating")
    status = Status().after(refused, 0.4)
    idle = status.after(None, 0.3)
    assert (idle.reason, idle.advice, idle.progress, idle.attempt) == ("low_parallax", "keep translating", 0.3, None)


@pytest.mark.parametrize("name", ["quest", "orb-slam3"])
def test_once_there_is_a_map_frames_are_no_longer_taken_in(name):
    observations = seen_from(make_poses(10))
    initializer = make_initializer(name, CAMERA, CONFIG)
    for observed in observations:
        if initializer.process_tracks(observed):
            break
    result = initializer.result
    read, status = initializer.frames_read, initializer.status
    assert read < len(observations)
    assert initializer.process_tracks(observations[-1]) is status
    assert initializer.process(np.zeros((480, 640), np.uint8)) is status
    assert (initializer.frames_read, initializer.map) == (read, result.map)
    assert initializer.finish().frames_to_init == result.frames_to_init == read


# -- images ---------------------------------------------------------------------------------------


def test_images_are_as_good_as_frames_and_initializers_share_nothing(room, room_fed_once):
    """Three side by side, one of them on another scene: each does what it does alone."""
    framed, plain, other = Initializer(room.camera), Initializer(room.camera), Initializer(CAMERA)
    for frame, observed in zip_longest(room.frames(0, 40), seen_from(make_poses(4))):
        framed.process(frame)
        plain.process(frame.image, frame.timestamp_s)
        if observed is not None:
            other.process_tracks(observed)
        if framed.map is not None:
            break
    assert other.map is not None
    assert shape_of(framed.map) == shape_of(plain.map) == shape_of(room_fed_once.result.map)
    assert [k.timestamp_s for k in plain.map.keyframes] == [k.timestamp_s for k in framed.map.keyframes]
    assert [a.evidence for a in plain.result.attempts] == [a.evidence for a in framed.result.attempts]


@pytest.mark.parametrize(
    ("image", "timestamp_s", "message"),
    [
        (np.zeros((480, 640)), None, "uint8"),
        (np.zeros((640, 480), np.uint8), None, "480, 640"),
        (np.zeros((480, 640, 4), np.uint8), None, "BGR"),
        (np.zeros((480, 640), np.uint8), float("nan"), "time stamp"),
        (np.zeros((480, 640), np.uint8), float("inf"), "time stamp"),
    ],
)
@pytest.mark.parametrize("name", ["quest", "orb-slam3"])
def test_what_is_no_image_is_refused_and_changes_nothing(name, image, timestamp_s, message):
    initializer = make_initializer(name, CAMERA, CONFIG)
    with pytest.raises(SlamInitError, match=message):
        initializer.process(image, timestamp_s)
    assert initializer.frames_read == 0
    assert not initializer.process(np.zeros((480, 640, 3), np.uint8), 0.0)


def test_an_image_gets_the_next_index_and_a_frame_keeps_its_own():
    image = np.zeros((480, 640), np.uint8)
    assert (frame_of(image, None, 7, CAMERA).index, frame_of(image, None, 7, CAMERA).timestamp_s) == (7, 7.0)
    named = replace(frame_of(image, 0.5, 7, CAMERA), name="a.png")
    assert frame_of(named, None, 12, CAMERA) is named
    later = frame_of(named, 0.75, 12, CAMERA)
    assert (later.index, later.name, later.timestamp_s) == (7, "a.png", 0.75)
    initializer = Initializer(CAMERA)
    initializer.process(named)
    initializer.process(image)
    assert [view.frame for view in initializer.history.between(-1, 100)] == [7, 8]


# -- what is kept ---------------------------------------------------------------------------------


class Diary(Recorder):
    def __init__(self):
        self.kept = []

    def undecided(self, maps):
        self.kept.append(len(maps))


def test_both_maps_of_a_plane_are_kept_until_the_views_decide():
    views, diary = planar_views([*STRAIGHT, *CURVE]), Diary()
    truth = Trajectory(np.arange(len(views)) / 30, (*STRAIGHT, *CURVE))
    initializer = Initializer(CAMERA, recorder=diary)
    for observed in views[: len(STRAIGHT)]:
        assert not initializer.process_tracks(observed)
    result = initializer.result
    assert (result.reason, result.map, len(result.hypotheses)) == ("ambiguous_plane", None, 2)
    assert "curve" in result.advice
    assert not result.margin.decides()
    assert not result.margin.reversed().decides()
    errors_deg = sorted(pose_errors(kept, truth).rotation_deg for kept in result.hypotheses)
    assert errors_deg[0] < 1 < errors_deg[1]
    assert diary.kept[-1] == 2

    source = GivenFrames(CAMERA, ())
    summary = summary_dict(result, source, CAMERA, "quest", 0)
    assert summary["advice"] == result.advice
    assert [len(kept["keyframes"]) for kept in summary["hypotheses"]] == [len(m.keyframes) for m in result.hypotheses]
    assert summary["margin"]["z"] == pytest.approx(result.margin.z, rel=1e-5)
    assert set(summary["hypotheses"][0]["keyframes"][0]) == {"frame", "timestamp", "q_wxyz", "t"}

    for observed in views[len(STRAIGHT) :]:
        if initializer.process_tracks(observed):
            break
    result = initializer.finish()
    assert result, result.reason
    assert result.hypotheses == (result.map,)
    assert result.margin is None or result.margin.decides()
    assert pose_errors(result.map, truth).rotation_deg < 1
    assert summary_dict(result, source, CAMERA, "quest", 0)["hypotheses"] == []


def test_the_result_may_be_asked_for_at_any_time_and_changes_nothing():
    asked, unasked = Initializer(CAMERA), Initializer(CAMERA)
    assert asked.result.reason == "too_few_frames"
    for observed in seen_from(make_poses(6)):
        asked.process_tracks(observed)
        assert bool(asked.result) == (asked.map is not None)
        unasked.process_tracks(observed)
    assert shape_of(asked.finish().map) == shape_of(unasked.finish().map)


# -- what is remembered ---------------------------------------------------------------------------


def refusal(k, verdict="low_parallax", **evidence):
    return Attempt((0, k), verdict, evidence, f"advice {k}", np.ones((9, 2)), np.ones((9, 2)), np.ones(9, bool))


def test_the_last_attempts_are_kept_without_their_matches_and_all_are_counted():
    log = AttemptLog(limit=10)
    for k in range(100):
        log.add(refusal(k, "static_camera" if k < 75 else "low_parallax"))
    assert len(log) == 100
    assert [attempt.frames[1] for attempt in log.kept] == list(range(90, 100))
    assert all(len(attempt.pixels1) == len(attempt.inliers) == 0 for attempt in log.kept)
    # Of the second half 25 stood still and 25 had low parallax; all that are kept say the latter.
    assert log.prevailing_reason() == "static_camera"
    assert log.advice("low_parallax") == "advice 99"
    assert "stands still" in log.advice("static_camera")  # no attempt that is kept said so
    assert log.notes() == ("100 attempts were made; the last 10 are listed",)


def test_an_initializer_that_waits_for_long_remembers_a_bounded_amount():
    (observed,) = seen_from([Pose.identity()], count=50)
    initializer = Initializer(CAMERA)
    frames = 150 + CONFIG.keyframes.window + 20
    for k in range(frames):
        initializer.process_tracks(replace(observed, frame=k))
    assert len(initializer.history) <= 150 + CONFIG.keyframes.window < frames
    assert len(initializer._progress) <= CONFIG.keyframes.window
    assert initializer._attempts._kept.maxlen == ATTEMPTS_KEPT
    assert len(initializer.result.attempts) == frames - 1


def test_a_calibration_is_suspected_where_most_checks_say_the_same():
    def notes(*factors):
        log = AttemptLog()
        for k, factor in enumerate(factors):
            found = {} if factor is None else {"suspected_focal_factor": factor}
            log.add(refusal(k, "pure_rotation", turning_focal_factor=factor or 1.0, **found))
        log.add(refusal(99))  # not checked
        return log.notes()

    (note,) = notes(1.05, 1.04, 1.05, None)
    assert "focal length 1.05 times the stated one: check the calibration" in note
    (note,) = notes(1.05, 1.04)
    assert notes(1.05) == ()  # by chance
    assert notes(1.021, 1.049) == ()  # not alike
    assert notes(1.05, 1.05, 1.05, None, None, None) == ()  # not most
    assert notes(0.92, 1.05, 1.09, 0.98) == ()  # not alike
    assert notes() == ()


def test_every_verdict_fits_the_log():
    log = AttemptLog()
    for verdict in (*REASONS, ACCEPTED):
        log.add(refusal(1, verdict))
    assert len(log) == len(REASONS) + 1


# -- the focal length ---------------------------------------------------------------------------------


def test_a_focal_length_that_the_views_cannot_tell_is_told():
    """A camera that goes sideways without turning: the map is good, and says that the prior is all it knows."""
    config = replace(CONFIG, map=replace(CONFIG.map, refine_focal=True))
    initializer = Initializer(CAMERA, config)
    for observed in seen_from([Pose(np.eye(3), np.array([0.08 * k, 0.0, 0.0])) for k in range(5)]):
        initializer.process_tracks(observed)
    result = initializer.finish()
    assert result.map.focal_factor_sigma > 0.9 * config.map.focal_sigma
    (note,) = result.notes
    assert "do not tell the focal length" in note
    assert "turn the camera" in note


def test_what_the_views_tell_better_than_the_prior_needs_no_note():
    prior, map_ = CONFIG.map.focal_sigma, make_map()
    assert focal_notes(None, CONFIG.map) == ()
    assert focal_notes(map_, CONFIG.map) == ()  # it was held
    assert focal_notes(replace(map_, focal_factor_sigma=0.7 * prior), CONFIG.map) == ()
    assert len(focal_notes(replace(map_, focal_factor_sigma=0.72 * prior), CONFIG.map)) == 1
