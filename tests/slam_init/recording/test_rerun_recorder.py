"""Laws of the recording: complete, sound for the viewer's own tool, equal for equal runs, bounded in size."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import rerun as rr
from make_map import CAMERAS, make_attempts, make_frame, make_map, make_observations, make_truth
from read_recording import chunks, column, entities, rerun_tool
from report_run import report_run
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from slam_init.errors import OutputError, SourceError
from slam_init.recording import rerun_recorder
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.types.scale import Scale, ScaleOrigin
from slam_init.types.status import CameraPose, PoseKind


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.rrd"


def pinhole(path):
    return RerunRecorder(path, CAMERAS["pinhole"], "arc")


def record(path, model="pinhole", color=True):
    map_ = make_map(model)
    report_run(RerunRecorder(path, CAMERAS[model], "arc", make_truth(map_), seed=3), model, color)
    return map_


def seen_in(recorder, seen):
    recorder.frame(make_frame(seen.frame, seen.timestamp_s, seen.name), seen)


def test_a_recording_holds_the_whole_run_and_passes_verification(path):
    for model, color in (("pinhole", True), ("radtan", False), ("fisheye", True)):
        map_ = record(path, model, color)
        assert rerun_tool("verify", path).returncode == 0
        keyframes = {f"/world/keyframes/{k.frame}" for k in map_.keyframes}
        expected = """/world/camera /world/camera/image /world/camera/image/keypoints /world/points
        /world/trajectory/est /world/trajectory/gt /pairs/image /pairs/image/inliers /pairs/image/moving /pairs/verdict
        /stats/counts/tracks /stats/parallax/median /pairs/evidence /advice /stats/risk_log10/bound
        /stats/risk_log10/direction /stats/risk_log10/total /stats/bundle/error /log"""
        assert keyframes | set(expected.split()) <= entities(path)
        assert column(path, "/log", "TextLog:level") == [["WARN"], ["WARN"], ["INFO"], ["INFO"]]


def test_dates_are_logged_as_dates_and_other_times_as_durations(path):
    """A bag that is opened beside the recording has dates: only then both lie at the same time."""
    first = make_observations(make_map())[0]
    for start_s, names, kind in (
        (2000.0, ["sensor_time"], "duration"),
        (1.4e9, ["sensor_date", "ros2_timestamp"], "timestamp"),
    ):
        with pinhole(path) as recorder:
            for k in range(2):
                seen_in(recorder, replace(first, frame=k, timestamp_s=start_s + 0.1 * k))
        for name in names:
            # The chunks have no order, and that of the style has no time.
            (batch,) = (batch for batch in chunks(path, "/stats/counts/tracks") if name in batch.schema.names)
            assert str(batch.schema.field(name).type).startswith(kind)


def test_a_recording_holds_the_map_before_and_after_bundle_adjustment_and_the_truth_on_the_path(path):
    map_ = record(path)
    columns = [column(path, "/world/points", name) for name in ("stage", "Points3D:positions")]
    stages = dict(zip(*columns, strict=True))
    np.testing.assert_allclose(stages[0], map_.points_before, atol=1e-6)
    np.testing.assert_allclose(stages[1], map_.points, atol=1e-6)
    assert column(path, "/stats/bundle/error", "Scalars:scalars") == [[error] for error in map_.bundle_errors]

    dashes = column(path, "/world/trajectory/gt", "LineStrips3D:strips")[0]
    truth, positions = np.concatenate(dashes), np.array([k.world_from_cam.t for k in map_.keyframes])
    np.testing.assert_allclose([truth[0], truth[-1]], positions[[0, -1]], atol=1e-6)
    off = [min(distance_to_segment(point, a, b) for a, b in pairwise(positions)) for point in truth]
    assert max(off) < 1e-6


def distance_to_segment(point, a, b):
    share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(a + share * (b - a) - point)


def test_two_undecided_maps_are_drawn_with_the_evidence_that_decides(path):
    map_ = make_map()
    with pinhole(path) as recorder:
        recorder.attempt(make_attempts(map_)[0])
        recorder.undecided((map_, map_))
    assert rerun_tool("verify", path).returncode == 0
    for k in range(2):
        paths = column(path, f"/world/trajectory/hypothesis{k + 1}", "LineStrips3D:strips")
        np.testing.assert_allclose(paths[0][0], [k.world_from_cam.t for k in map_.keyframes], atol=1e-6)
        points = column(path, f"/candidates/{'ab'[k]}/points", "Points3D:positions")[0]
        np.testing.assert_allclose(points, map_.points, atol=1e-6)
    assert "one of the maps is right" in column(path, "/candidates/evidence", "TextDocument:text")[0][0]


def test_without_a_map_the_camera_turns_and_a_rolling_shutter_is_shown_before_and_after_its_correction(path):
    seen = make_observations(make_map())[0]
    corrected = seen.pixels + np.array([1.0, -2.0])
    turned = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix()
    with pinhole(path) as recorder:
        seen_in(recorder, seen)
        recorder.row_times(seen, corrected)
        recorder.waiting(CameraPose(PoseKind.PROVISIONAL, turned, 0.3, np.ones(3), 2.0, 0))
    for name, pixels in (("before", seen.pixels), ("after", corrected)):
        points = column(path, f"/world/camera/image/readout/{name}", "Points2D:positions")[0]
        np.testing.assert_allclose(points, pixels + 0.5, atol=1e-3)
    [matrix] = column(path, "/world/camera", "Transform3D:mat3x3")
    # Rerun stores matrices by columns, so that the transposed matrix is the one that was given.
    np.testing.assert_allclose(np.reshape(matrix, (3, 3)), turned, atol=1e-6)
    assert column(path, "/stats/direction/rotation", "Scalars:scalars") == [[0.3]]


def test_equal_runs_have_equal_content_and_other_runs_do_not(tmp_path):
    first, second, other = (tmp_path / f"{name}.rrd" for name in "abc")
    record(first)
    record(second)
    report_run(pinhole(other))
    assert rerun_tool("compare", "--unordered", first, second).returncode == 0
    assert rerun_tool("compare", "--unordered", first, other).returncode != 0
    assert "/world/trajectory/gt" in entities(first) - entities(other)  # only the estimate without a ground truth


def test_the_id_depends_on_the_source_and_the_seed_only(tmp_path):
    ids = []
    for i, (source, seed) in enumerate([("a", 0), ("a", 0), ("b", 0), ("a", 1)]):
        RerunRecorder(tmp_path / f"{i}.rrd", CAMERAS["pinhole"], source, seed=seed).close()
        ids.append(RrdReader(tmp_path / f"{i}.rrd").recordings()[0].recording_id)
    assert ids[0] == ids[1]
    assert len(set(ids)) == 3


def test_of_many_frames_only_some_images_are_kept_but_all_tracks(path, monkeypatch):
    monkeypatch.setattr(rerun_recorder, "FRAMES_AT_FULL_RATE", 5)
    first = make_observations(make_map())[0]
    with pinhole(path) as recorder:
        for i in range(15):
            seen_in(recorder, replace(first, frame=i, timestamp_s=i / 30))
    batches = [b for b in chunks(path, "/world/camera/image") if "EncodedImage:blob" in b.schema.names]
    assert [frame for b in batches for frame in b["frame"].to_pylist()] == [0, 1, 2, 3, 4, 6, 8, 12]
    assert len(column(path, "/stats/counts/tracks", "Scalars:scalars")) == 15


def test_a_path_that_cannot_be_written_is_an_error_at_once(tmp_path):
    for path in (tmp_path, tmp_path / "missing" / "a.rrd"):
        with pytest.raises(OutputError, match="cannot write the recording"):
            pinhole(path)


def test_a_disk_that_fails_is_an_error_and_leaves_no_file(path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    recorder, seen = pinhole(path), make_observations(make_map())[0]
    seen_in(recorder, seen)
    with monkeypatch.context() as patched, pytest.raises(OutputError, match="No space left on device: make room"):
        patched.setattr(rerun_recorder.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
        seen_in(recorder, replace(seen, frame=seen.frame + 1))
    monkeypatch.setattr(type(path), "replace", full)
    with pytest.raises(OutputError, match="No space left on device: make room"):
        recorder.close()
    assert list(path.parent.iterdir()) == []


def test_a_file_that_is_gone_is_an_error_at_the_next_frame_and_stays_away(path):
    with pytest.raises(OutputError, match="the file is gone"), pinhole(path) as recorder:
        path.with_suffix(".partial.rrd").unlink()
        seen_in(recorder, make_observations(make_map())[0])
    recorder.close()
    assert list(path.parent.iterdir()) == []


def test_an_error_leaves_the_earlier_recording_and_an_interrupt_the_new_one(path):
    path.write_bytes(b"old")
    for error in (SourceError("frame 7: cut off"), KeyboardInterrupt()):
        with pytest.raises(type(error)), pinhole(path) as recorder:
            seen_in(recorder, make_observations(make_map())[0])
            assert path.read_bytes() == b"old"
            raise error
        assert [file.name for file in path.parent.iterdir()] == ["a.rrd"]
        assert (path.read_bytes() == b"old") == isinstance(error, SourceError)
    recorder.close()  # a second time
    assert rerun_tool("verify", path).returncode == 0


def test_a_map_that_has_grown_is_drawn_with_its_scale_and_cleared_when_it_is_lost(path):
    map_ = make_map()
    later = replace(map_.keyframes[-1], frame=40)
    with pinhole(path) as recorder:
        recorder.initialized(map_, [])
        recorder.scaled(Scale(ScaleOrigin.HEIGHT, 4.0, 0.02))
        recorder.refined(replace(map_, keyframes=(*map_.keyframes, later), points=2 * map_.points))
        recorder.restarted()
    assert {"/world/keyframes/40", "/world/keyframes"} <= entities(path)
    columns = column(path, "/world/points", "Points3D:positions")
    assert any(np.allclose(points, 2 * map_.points, atol=1e-6) for points in columns if points)
    (labels,) = [label for label in column(path, "/world/scale", "LineStrips3D:labels") if label]
    assert labels[0].startswith("1 m (1 unit = 4 m +- 2.0%")
