"""Laws of the initializer, frame by frame: status, images and tracks, undecided maps, bounded memory."""

import inspect
import pickle
from dataclasses import replace
from itertools import zip_longest

import numpy as np
import pytest
from make_map import bytes_of, make_poses
from make_scene import CAMERA, CONFIG, cloud, observe, plane, texture, window
from make_summary import summarize

from quest.geometry.quaternion import rotation_from_vector
from slam_init.compare.measures import pose_errors
from slam_init.config import Config, TrackingConfig
from slam_init.errors import SlamInitError
from slam_init.frontend.matchers import SiftMatcher
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.methods import make_initializer
from slam_init.recording.recorder import Recorder
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.refusal import REASONS, Verdict

#: Straight towards a plane: all views agree with the second motion.
STRAIGHT = [Pose(np.eye(3), k * np.array([0.02, 0.0, 0.06])) for k in range(5)]
#: Then in a curve, for long enough that the pair is tried again.
CURVE = [
    Pose(rotation_from_vector(np.array([0.015, -0.025, 0.0]) * k), STRAIGHT[4].t + np.array([0.04, 0.025, -0.01]) * k)
    for k in range(1, 16)
]
#: Largest number of frames in the history: the last frames, and the candidates that are older.
HISTORY = inspect.signature(Tracker).parameters["history_limit"].default + CONFIG.keyframes.window


def planar_views(poses, seed=2, noise_px=0.5):
    rng = np.random.default_rng(seed)
    return observe(CAMERA, poses, plane(rng, 200), noise_px, rng)


def seen_from(poses, noise_px=0.3, count=300):
    return observe(CAMERA, poses, cloud(np.random.default_rng(0), count), noise_px, np.random.default_rng(1))


class Diary(Recorder):
    """Keeps the reports of the initializer."""

    def __init__(self):
        self.reports = []

    def frame(self, frame, observations):
        assert observations.frame == frame.index
        self.reports.append(("frame", frame.index))

    def attempt(self, attempt):
        self.reports.append(("attempt", attempt.verdict))

    def initialized(self, map_, observations):
        assert [o.frame for o in observations] == [keyframe.frame for keyframe in map_.keyframes]
        self.reports.append(("initialized", len(map_.keyframes)))

    def undecided(self, maps):
        self.reports.append(("undecided", len(maps)))

    def reports_of(self, kind):
        return [value for name, value in self.reports if name == kind]


# -- the status -----------------------------------------------------------------------------------


def test_the_status_begins_at_zero_and_ends_at_one():
    initializer = Initializer(CAMERA)
    assert (initializer.status.state, initializer.status.progress) == ("waiting", 0.0)
    statuses = [initializer.process_tracks(observed) for observed in seen_from(make_poses(8))]
    assert statuses[0].progress == 0
    assert not statuses[0]
    assert statuses[0].attempt is None
    last = statuses[-1]
    assert last
    assert (last.state, last.progress, last.reason, last.advice) == ("initialized", 1.0, None, "")
    assert initializer.status is last
    for status in statuses:
        assert bool(status) == (status.state == "initialized") == (status.progress == 1)
        if not status:
            assert 0 <= status.progress < 1
            assert status.reason in REASONS
            assert status.advice


def test_the_progress_is_that_of_the_best_reference_and_falls_with_it():
    initializer = Initializer(CAMERA)
    for observed in planar_views(STRAIGHT):
        before = initializer.process_tracks(observed).progress
    assert before > 0.75
    # Another scene without common tracks: the references of the first scene are dropped one by one.
    elsewhere = seen_from([Pose.identity()] * 400, noise_px=0.1, count=60)
    for k, observed in enumerate(elsewhere[: 10 * (CONFIG.keyframes.window + 3)]):
        other = replace(observed, frame=10 + k, timestamp_s=10.0 + k, track_ids=observed.track_ids + 100_000)
        status = initializer.process_tracks(other)
    assert status.progress < 0.5


@pytest.mark.parametrize("name", ["quest", "orb-slam3"])
def test_frames_are_ignored_once_there_is_a_map(name):
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


def test_an_initializer_reports_each_frame_attempt_and_map_to_its_recorder(room):
    diary = Diary()
    initializer = Initializer(room.camera, recorder=diary)
    attempts = []
    for frame in room.frames():
        status = initializer.process(frame)
        if status.attempt is not None:
            attempts.append(status.attempt)
        if status:
            break
    result = initializer.finish()
    assert result.map is initializer.map is not None
    assert diary.reports_of("frame") == list(range(result.frames_read))
    assert diary.reports_of("attempt") == [a.verdict for a in attempts] == [a.verdict for a in result.attempts]
    assert diary.reports[-1] == ("initialized", len(result.map.keyframes))
    assert attempts[-1].verdict == Verdict.ACCEPTED
    assert attempts[-1].inliers.any()
    assert set(result.timing_ms) >= {"track", "two_view", "map"}


def test_the_result_can_be_read_at_any_time_without_a_change():
    asked, unasked = Initializer(CAMERA), Initializer(CAMERA)
    assert asked.result.reason == "too_few_frames"
    for observed in seen_from(make_poses(6)):
        asked.process_tracks(observed)
        assert bool(asked.result) == (asked.map is not None)
        unasked.process_tracks(observed)
    assert bytes_of(asked.finish().map) == bytes_of(unasked.finish().map)


# -- images and tracks ----------------------------------------------------------------------------


def test_images_give_the_same_map_as_frames_and_initializers_share_nothing(room, room_fed_once):
    """Two initializers run side by side, one of them on another scene; each gives the map that it gives alone."""
    whole = Config()
    plain, other, framed = Initializer(room.camera, whole), Initializer(CAMERA, whole), room_fed_once.result
    for frame, observed in zip_longest(room.frames(0, 40), seen_from(make_poses(4))):
        plain.process(frame.image, frame.timestamp_s)
        if observed is not None:
            other.process_tracks(observed)
        if plain.map is not None:
            break
    assert other.map is not None
    assert bytes_of(framed.map) == bytes_of(plain.map)
    assert [k.timestamp_s for k in plain.map.keyframes] == [k.timestamp_s for k in framed.map.keyframes]
    assert [a.gates for a in plain.result.attempts] == [a.gates for a in framed.attempts]


def test_views_of_other_arrays_and_read_only_images_are_images():
    wide = np.random.default_rng(0).integers(0, 255, (120, 320, 3), np.uint8)
    wide.setflags(write=False)
    views = (wide[:, ::-2], wide[::-1, ::2, ::-1], wide[:, :160, 0])
    found = []
    for images in (views, [view.copy() for view in views]):
        initializer = Initializer(CAMERA.scaled(0.25), CONFIG)
        for k, image in enumerate(images):
            initializer.process(image, 0.1 * k)
        found.append([observed.pixels.tobytes() for observed in initializer.history])
    assert found[0] == found[1] and len(found[0]) == 3


@pytest.mark.parametrize("matcher", [None, SiftMatcher()])
def test_a_caller_may_read_each_image_and_each_mask_into_the_same_array(matcher):
    image = texture(0, 480, 900)
    mask = np.full((480, 640), 255, np.uint8)
    found = []
    for reused in (True, False):
        initializer = Initializer(CAMERA, CONFIG, matcher=matcher)
        place, covered = np.empty((480, 640), np.uint8), mask.copy()
        for k in range(4):
            place = place if reused else np.empty_like(place)
            covered = covered if reused else mask.copy()
            place[:], covered[:] = image[:, 6 * k : 6 * k + 640], mask
            covered[:, : 40 * k] = 0
            initializer.process(place, 0.1 * k, mask=covered)
        found.append([observed.pixels.tobytes() for observed in initializer.history])
    assert found[0] == found[1] and len(found[0]) == 4


def test_a_frame_whose_matcher_failed_can_be_tried_again(room):
    busy = [2]

    def sometimes(image1, image2):
        if busy and busy[0] == matched[0]:
            busy.clear()
            raise RuntimeError("busy")
        return sift(image1, image2)

    sift, frames, found = SiftMatcher(), list(room.frames(0, 4)), []
    for retried in (True, False):
        matched = [0]
        initializer = Initializer(room.camera, CONFIG, matcher=sometimes if retried else sift)
        for frame in frames:
            matched[0] = frame.index
            if retried and frame.index == 2:
                with pytest.raises(SlamInitError, match="busy"):
                    initializer.process(frame)
            initializer.process(frame)
        found.append([observed.pixels.tobytes() for observed in initializer.history])
    assert found[0] == found[1] and len(found[0]) == 4


def test_images_get_the_indices_that_follow_the_last_frame(room):
    (frame,) = room.frames(0, 1)
    initializer = Initializer(room.camera)
    initializer.process(replace(frame, index=7))
    initializer.process(frame.image)
    assert [view.frame for view in initializer.history] == [7, 8]


def all_of(result):
    """Everything that a result holds except times, as bytes."""
    map_ = result.map
    graph = map_.graph.serialize() if map_ is not None else ""
    values = map_.values.serialize() if map_ is not None else ""
    plain = None if map_ is None else replace(map_, recipe=None)
    return pickle.dumps((graph, values, plain, result.reason, result.frames_read, result.attempts))


def jumping_frames():
    """Windows on a texture that are too far apart for optical flow; descriptors add tracks to earlier frames."""
    image = texture(0, 480, 1500)
    return [window(image, 170 * k, 0, 640, 480, k) for k in range(3)]


@pytest.mark.parametrize(("name", "jumping"), [("quest", False), ("orb-slam3", False), ("quest", True)])
def test_the_tracks_of_a_tracker_give_the_same_result_as_its_images(room, name, jumping):
    frames = jumping_frames() if jumping else room.frames(0, 20)
    seeing = make_initializer(name, room.camera, CONFIG)
    tracked, revisions = [], 0
    for frame in frames:
        seeing.process(frame)
        tracked.append((seeing.history[frame.index], seeing.tracker.revised))
        revisions += len(seeing.tracker.revised)
        if seeing.map is not None:
            break
    assert (revisions > 0) == jumping
    # Each frame has the tracks and the revisions that were known at that frame.
    blind = make_initializer(name, room.camera, CONFIG)
    for current, revised in tracked:
        blind.process_tracks(current, revised=revised)
    assert all_of(seeing.finish()) == all_of(blind.finish())


# -- undecided maps -------------------------------------------------------------------------------


def test_both_maps_of_a_plane_are_kept_until_the_views_decide():
    views = planar_views([*STRAIGHT, *CURVE])
    truth = Trajectory(np.arange(len(views)) / 30, (*STRAIGHT, *CURVE))
    initializer = Initializer(CAMERA)
    for observed in views[: len(STRAIGHT)]:
        assert not initializer.process_tracks(observed)
    result = initializer.result
    assert (result.reason, result.map, len(result.hypotheses)) == ("ambiguous_plane", None, 2)
    assert "curve" in result.advice
    assert not result.margin.decides()
    errors_deg = sorted(pose_errors(kept, truth).rotation_deg for kept in result.hypotheses)
    assert errors_deg[0] < 1 < errors_deg[1]
    assert [len(kept.keyframes) for kept in summarize(result).hypotheses] == [
        len(map_.keyframes) for map_ in result.hypotheses
    ]

    for observed in views[len(STRAIGHT) :]:
        if initializer.process_tracks(observed):
            break
    result = initializer.finish()
    assert result, result.reason
    assert result.hypotheses == (result.map,)
    assert result.margin is None or result.margin.decides()
    assert pose_errors(result.map, truth).rotation_deg < 1
    assert summarize(result).hypotheses == ()


def test_both_maps_of_a_plane_that_stays_undecided_are_reported_once_at_the_end():
    initializer = Initializer(CAMERA, recorder=(diary := Diary()))
    for observed in planar_views(STRAIGHT):
        initializer.process_tracks(observed)
    assert diary.reports_of("undecided") == []
    initializer.finish()
    assert diary.reports_of("undecided") == [2]


def test_a_focal_length_that_the_views_cannot_determine_gets_a_note():
    """A camera that moves sideways without rotation: the map is good, and its focal length is that of the prior."""
    config = replace(CONFIG, map=replace(CONFIG.map, refine_focal=True))
    initializer = Initializer(CAMERA, config)
    for observed in seen_from([Pose(np.eye(3), np.array([0.08 * k, 0.0, 0.0])) for k in range(5)]):
        initializer.process_tracks(observed)
    result = initializer.finish()
    assert result.map.focal_factor_sigma > 0.9 * config.map.focal_sigma
    (note,) = result.notes
    assert "do not determine the focal length" in note
    assert "turn the camera" in note


# -- memory ---------------------------------------------------------------------------------------


def test_the_history_does_not_grow_with_a_video_of_a_static_camera(room):
    (frame,) = room.frames(0, 1)
    small = replace(frame, image=np.ascontiguousarray(frame.image[::4, ::4]))
    initializer = Initializer(room.camera.scaled(0.25), Config(tracking=TrackingConfig(max_tracks=60)))
    for k in range(HISTORY + 20):
        initializer.process(replace(small, index=k, timestamp_s=k / 30))
    assert len(initializer.tracker.history) <= HISTORY
    assert len(initializer.keyframes.candidates) <= CONFIG.keyframes.window
    assert all(len(attempt.pixels1) == 0 for attempt in initializer.finish().attempts)
