"""The story end to end: what initializes does so correctly, what cannot says why."""

import inspect
import json
from dataclasses import replace

import numpy as np
import pytest
from make_scene import CAMERA, CONFIG
from make_source import GivenFrames, synth
from paths import DATA

from slam_init.config import Config, TrackingConfig, load_config
from slam_init.datasets import open_source
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.recording.recorder import Recorder
from slam_init.runner import run
from slam_init.types.frame import Frame
from slam_init.types.reasons import ACCEPTED, REASONS

SMALL = {"width": 320, "height": 240}
#: The last frames, and the candidates that are older.
HISTORY = inspect.signature(Tracker).parameters["history_limit"].default + CONFIG.keyframes.window


def assert_correct(summary, rotation_deg, direction_deg):
    assert summary["status"] == "initialized", summary["reason"]
    assert summary["ground_truth"]["rotation_error_deg"] < rotation_deg
    assert summary["ground_truth"]["direction_error_deg"] < direction_deg


def without_timing(summary):
    return {key: value for key, value in summary.items() if key != "timing_ms"}


# -- what initializes -----------------------------------------------------------------------------


def test_the_room_initializes_correctly(room_run):
    assert_correct(room_run.summary, 2.0, 5.0)
    assert room_run.summary["scene"] == "general"
    assert room_run.summary["ground_truth"]["ate_rmse"] < 0.05 * room_run.summary["ground_truth"]["path_length"]


def test_the_result_is_consistent_in_itself(room_run):
    result, map_ = room_run.result, room_run.result.map
    assert result
    assert result.reason is None
    assert result.frames_to_init == result.frames_read
    frames = [keyframe.frame for keyframe in map_.keyframes]
    assert len(frames) >= 3
    assert frames == sorted(set(frames))
    assert frames[-1] < result.frames_read
    assert all(attempt.verdict in (ACCEPTED, *REASONS) for attempt in result.attempts)
    assert [attempt.verdict for attempt in result.attempts].count(ACCEPTED) == 1
    assert result.attempts[-1].verdict == ACCEPTED
    assert set(result.attempts[-1].frames) >= set(frames)
    assert all(attempt.advice for attempt in result.attempts[:-1])


def test_the_map_is_what_it_says(room_run):
    map_, camera = room_run.result.map, room_run.source.camera
    count = len(map_.points)
    assert (np.diff(map_.track_ids) > 0).all()
    assert np.bincount(map_.observation_landmarks, minlength=count).min() >= 2
    assert map_.colors.shape == map_.points.shape == map_.points_before.shape == (count, 3)
    assert map_.pose_covariances.shape == (len(map_.keyframes), 6, 6)
    np.testing.assert_allclose(map_.keyframes[0].world_from_cam.R, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(map_.keyframes[0].world_from_cam.t, 0, atol=1e-6)
    assert np.median(map_.points[:, 2]) == pytest.approx(1.0)
    residuals = np.zeros_like(map_.observation_pixels)
    for k, keyframe in enumerate(map_.keyframes):
        mine = map_.observation_keyframes == k
        in_camera = keyframe.world_from_cam.inverse().apply(map_.points[map_.observation_landmarks[mine]])
        residuals[mine] = camera.project(in_camera) - map_.observation_pixels[mine]
    rmse_px = np.sqrt(np.mean(np.sum(residuals**2, axis=1)))
    assert rmse_px == pytest.approx(map_.reprojection_rmse_px, rel=1e-3)
    assert rmse_px < 1.5
    assert map_.bundle_errors[-1] <= map_.bundle_errors[0]


def test_all_files_are_written(room_run):
    written = {path.relative_to(room_run.out).as_posix() for path in room_run.out.rglob("*") if path.is_file()}
    assert written == {
        "summary.json", "trajectory.txt", "map.ply", "colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt",
        "graph.txt", "values.txt", "continued.txt", "config.toml", "recording.rrd",
    }  # fmt: skip
    assert json.loads((room_run.out / "summary.json").read_text()) == room_run.summary
    assert load_config(room_run.out / "config.toml") == Config()
    trajectory = np.loadtxt(room_run.out / "trajectory.txt")
    assert len(trajectory) == len(room_run.result.map.keyframes) == len(room_run.summary["keyframes"])
    assert room_run.summary["landmarks"] == len(room_run.result.map.points)


def test_the_frames_after_are_located(room_run):
    continued = room_run.summary["continued"]
    assert continued["frames"] == continued["located"] == 10
    assert 0.5 < continued["survival_median"] <= 1
    assert len(np.loadtxt(room_run.out / "continued.txt")) == 10


def test_the_same_seed_gives_the_same_files_but_for_the_timing(room_run, tmp_path):
    source = room_run.source
    _, summary = run(source, source.camera, Config(), out=tmp_path, continue_frames=10)
    assert without_timing(summary) == without_timing(room_run.summary)
    for path in sorted(room_run.out.rglob("*")):
        if path.is_file() and path.name not in ("summary.json", "recording.rrd"):
            assert (tmp_path / path.relative_to(room_run.out)).read_bytes() == path.read_bytes(), path.name


def test_another_start_counts_from_itself_and_names_absolute_frames(room):
    result, summary = run(room, room.camera, Config(), start=15, max_frames=40)
    assert_correct(summary, 2.0, 5.0)
    assert min(keyframe["frame"] for keyframe in summary["keyframes"]) >= 15
    assert summary["frames_to_init"] == result.frames_read <= 40
    assert max(keyframe["frame"] for keyframe in summary["keyframes"]) == 15 + result.frames_read - 1


@pytest.mark.slow
def test_a_wall_is_correct_or_ambiguous():
    """One plane: two motions explain two views of it; the pipeline waits, or knows which is true."""
    wall = synth("wall")
    _, summary = run(wall, wall.camera, Config())
    if summary["status"] == "initialized":
        assert summary["scene"] == "planar"
        assert_correct(summary, 5.0, 15.0)
    else:
        assert summary["reason"] in ("ambiguous_plane", "low_parallax")


# -- what cannot ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "reason"), [("static", "static_camera"), ("rotation", "pure_rotation")])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_camera_that_does_not_translate_never_initializes(tmp_path, scene, reason, seed):
    source = synth(scene, seed, frames=30, **SMALL)
    result, summary = run(source, source.camera, Config(), out=tmp_path)
    assert not result
    assert result.map is None
    assert result.frames_to_init is None
    assert (result.status, result.reason) == ("not_initialized", reason)
    assert result.frames_read == 30
    assert result.attempts
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    assert {path.name for path in tmp_path.iterdir()} == {"summary.json", "config.toml", "recording.rrd"}


def test_frames_beyond_the_maximum_are_not_read(room):
    read = []

    class Counting(GivenFrames):
        def frames(self, start=0, max_frames=None):
            for frame in super().frames(start, max_frames):
                read.append(frame.index)
                yield frame

    source = Counting(room.camera, tuple(room.frames(0, 6)))
    result, _ = run(source, room.camera, Config(), max_frames=3)
    assert result.frames_read == 3
    assert read == [0, 1, 2]


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_frames_are_too_few(room, count):
    source = GivenFrames(room.camera, tuple(room.frames(0, count)))
    result, summary = run(source, room.camera, Config())
    assert (result.reason, result.frames_read, result.attempts) == ("too_few_frames", count, ())
    assert summary["reason"] == "too_few_frames"


def test_the_same_image_twice_is_a_static_camera(room):
    (frame,) = room.frames(0, 1)
    source = GivenFrames(room.camera, (frame, replace(frame, index=1, timestamp_s=frame.timestamp_s + 0.1)))
    assert run(source, room.camera, Config())[0].reason == "static_camera"


def test_blank_images_have_too_few_features():
    blank = np.full((480, 640), 90, np.uint8)
    frames = tuple(Frame(k, k / 30, "", blank) for k in range(5))
    result, _ = run(GivenFrames(CAMERA, frames), CAMERA, Config())
    assert result.reason == "too_few_features"


# -- frame by frame -------------------------------------------------------------------------------


class Diary(Recorder):
    """Remembers what it was told."""

    def __init__(self):
        self.told = []

    def frame(self, frame, observations):
        assert observations.frame == frame.index
        self.told.append(("frame", frame.index))

    def attempt(self, attempt):
        self.told.append(("attempt", attempt.verdict))

    def initialized(self, map_, observations):
        assert [o.frame for o in observations] == [keyframe.frame for keyframe in map_.keyframes]
        self.told.append(("initialized", len(map_.keyframes)))


def test_an_initializer_needs_no_folder_and_tells_its_recorder(room):
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
    assert [index for kind, index in diary.told if kind == "frame"] == list(range(result.frames_read))
    assert [verdict for kind, verdict in diary.told if kind == "attempt"] == [a.verdict for a in attempts]
    assert diary.told[-1] == ("initialized", len(result.map.keyframes))
    assert [a.verdict for a in result.attempts] == [a.verdict for a in attempts]
    assert attempts[-1].verdict == ACCEPTED
    assert attempts[-1].inliers.any()
    assert set(result.timing_ms) >= {"track", "two_view", "map"}


def test_what_is_remembered_does_not_grow_with_the_video(room):
    """More frames of a camera that stands still than the history holds."""
    (frame,) = room.frames(0, 1)
    small = replace(frame, image=np.ascontiguousarray(frame.image[::4, ::4]))
    initializer = Initializer(room.camera.scaled(0.25), Config(tracking=TrackingConfig(max_tracks=60)))
    for k in range(HISTORY + 20):
        initializer.process(replace(small, index=k, timestamp_s=k / 30))
    assert len(initializer.tracker.history) <= HISTORY
    assert len(initializer.keyframes.candidates) <= CONFIG.keyframes.window
    assert all(len(attempt.pixels1) == 0 for attempt in initializer.finish().attempts)


# -- real data ------------------------------------------------------------------------------------


def run_real(name):
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"no {name} in {DATA}: set SLAM_INIT_DATA to the folder of the data sets")
    source = open_source(str(folder))
    return run(source, source.camera, Config())[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tsukuba/new_tsukuba_150", "kitti/06_start"])
def test_a_real_video_that_moves_initializes_correctly(name):
    assert_correct(run_real(name), 2.0, 5.0)


@pytest.mark.slow
def test_a_real_camera_that_stands_still_is_static():
    summary = run_real("euroc/V1_01_static")
    assert (summary["status"], summary["reason"]) == ("not_initialized", "static_camera")
