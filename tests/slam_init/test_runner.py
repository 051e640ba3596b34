"""Whole runs: correct maps and complete files, or a reason why there is no map."""

import json

import numpy as np
import pytest
from make_source import GivenFrames, synth
from paths import DATA
from written import contents

from slam_init.calibration.files import camera_with_focal
from slam_init.config import Config, load_config
from slam_init.datasets import open_source
from slam_init.errors import SourceError
from slam_init.output.summary import Summary
from slam_init.runner import run
from slam_init.types.refusal import REASONS

SMALL = {"width": 320, "height": 240}


def assert_correct(summary: Summary) -> None:
    """A map is correct by the protocol of the comparison."""
    assert summary.status == "initialized", summary.reason
    assert summary.ground_truth.rotation_error_deg < 5
    assert summary.ground_truth.direction_error_deg < 15


def same_in_each_run(summary: Summary) -> dict:
    """The fields that are equal in two equal runs."""
    return {key: value for key, value in summary.as_dict().items() if key not in ("timing_ms", "provenance")}


# -- runs that initialize -------------------------------------------------------------------------


def test_the_room_initializes_correctly(room_run):
    assert_correct(room_run.summary)
    assert room_run.summary.scene == "general"
    truth = room_run.summary.ground_truth
    assert truth.ate_rmse < 0.05 * truth.path_length


def test_the_fields_of_the_map_are_consistent(room_run):
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
        rows = map_.observation_keyframes == k
        in_camera = keyframe.world_from_cam.inverse().apply(map_.points[map_.observation_landmarks[rows]])
        residuals[rows] = camera.project(in_camera) - map_.observation_pixels[rows]
    rmse_px = np.sqrt(np.mean(np.sum(residuals**2, axis=1)))
    assert rmse_px == pytest.approx(map_.reprojection_rmse_px, rel=1e-3)
    assert rmse_px < 1.5
    assert map_.bundle_errors[-1] <= map_.bundle_errors[0]


def test_all_files_are_written(room_run):
    assert set(contents(room_run.out)) == {
        "summary.json", "trajectory.txt", "map.ply", "colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt",
        "graph.txt", "values.txt", "continued.txt", "config.toml", "overview.png", "recording.rrd", "handover.npz",
        "transforms.json",
    }  # fmt: skip
    assert json.loads((room_run.out / "summary.json").read_text()) == room_run.summary.as_dict()
    assert load_config(room_run.out / "config.toml") == Config()
    trajectory = np.loadtxt(room_run.out / "trajectory.txt")
    assert len(trajectory) == len(room_run.result.map.keyframes) == len(room_run.summary.keyframes)
    assert room_run.summary.landmarks == len(room_run.result.map.points)


@pytest.mark.parametrize("failing", [False, True])
def test_a_run_without_its_picture_has_all_other_files(tmp_path, monkeypatch, failing):
    source = synth("static", frames=2, **SMALL)
    if failing:
        monkeypatch.setattr("slam_init.runner.overview_png", lambda *_: 1 / 0)
        with pytest.warns(RuntimeWarning, match=r"overview.png was not made: division"):
            run(source, source.camera, Config(), out=tmp_path)
    else:
        run(source, source.camera, Config(), out=tmp_path, overview=False)
    assert set(contents(tmp_path)) == {"summary.json", "config.toml", "recording.rrd"}


def test_the_same_seed_gives_the_same_files(room_run, tmp_path):
    source = room_run.source
    _, summary = run(source, source.camera, Config(), out=tmp_path, continue_frames=10)
    assert same_in_each_run(summary) == same_in_each_run(room_run.summary)
    assert summary.provenance.input_blake2b == room_run.summary.provenance.input_blake2b
    for path in sorted(room_run.out.rglob("*")):
        if path.is_file() and path.name not in ("summary.json", "recording.rrd"):
            assert (tmp_path / path.relative_to(room_run.out)).read_bytes() == path.read_bytes(), path.name


def test_with_another_start_frames_are_counted_from_the_start_and_named_by_absolute_index(room):
    result, summary = run(room, room.camera, Config(), start=15, max_frames=40)
    assert_correct(summary)
    assert min(keyframe.frame for keyframe in summary.keyframes) >= 15
    assert summary.frames_to_init == result.frames_read <= 40
    assert max(keyframe.frame for keyframe in summary.keyframes) == 15 + result.frames_read - 1


# -- runs that do not initialize ------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "reason"), [("static", "static_camera"), ("rotation", "pure_rotation")])
def test_a_camera_that_does_not_translate_never_initializes(tmp_path, scene, reason):
    source = synth(scene, frames=10, slow_start=1, **SMALL)
    result, summary = run(source, source.camera, Config(), out=tmp_path)
    assert not result
    assert result.map is None
    assert result.frames_to_init is None
    assert (result.status, result.reason) == ("not_initialized", reason)
    assert result.frames_read == 10
    assert {attempt.verdict for attempt in result.attempts} <= set(REASONS)
    assert json.loads((tmp_path / "summary.json").read_text()) == summary.as_dict()
    assert set(contents(tmp_path)) == {"summary.json", "config.toml", "overview.png", "recording.rrd"}


def test_frames_beyond_the_maximum_are_not_read(room):
    read = []

    class Counting(GivenFrames):
        def frames(self, start=0, max_frames=None):
            for frame in super().frames(start, max_frames):
                read.append(frame.index)
                yield frame

    result, _ = run(Counting(room.camera, tuple(room.frames(0, 6))), room.camera, Config(), max_frames=3)
    assert result.frames_read == 3
    assert read == [0, 1, 2]


# -- errors ---------------------------------------------------------------------------------------


class Broken(GivenFrames):
    """A source whose frames after the given ones cannot be read."""

    def frames(self, start=0, max_frames=None):
        yield from super().frames(start, max_frames)
        raise SourceError("the next frame is truncated")


def test_a_frame_that_cannot_be_read_ends_the_continuation_with_a_note(room, room_run):
    count = room_run.result.frames_to_init + 3
    source = Broken(room.camera, tuple(room.frames(0, count)))
    result, summary = run(source, room.camera, Config(), continue_frames=10)
    assert result
    assert summary.continued.frames == 3
    assert summary.notes[-1] == "the continuation ended early: the next frame is truncated"
    with pytest.raises(SourceError):
        run(Broken(room.camera, tuple(room.frames(0, 2))), room.camera, Config())


# -- real data ------------------------------------------------------------------------------------


def run_real(name):
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"no {name} in {DATA}: set SLAM_INIT_DATA to the folder of the data sets")
    source = open_source(str(folder))
    return run(source, source.camera, Config())[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tsukuba/new_tsukuba_150", "kitti/06_start"])
def test_a_real_video_of_a_moving_camera_initializes_correctly(name):
    assert_correct(run_real(name))


def test_a_stated_focal_length_that_the_motion_corrects_is_reported_beside_the_estimate(room):
    stated = camera_with_focal((640, 480), 1.03 * room.camera.fx, 0.05, "stated")
    result, _ = run(room, stated, Config(), max_frames=30)
    assert result.map is not None and result.map.camera.source == "estimated"
    (note,) = [note for note in result.notes if "stated focal length" in note]
    assert f"{stated.fx:.0f} +- {0.05 * stated.fx:.0f} px" in note and f"{result.map.camera.fx:.0f} px" in note
