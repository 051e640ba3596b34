"""The recording: complete, verified by the viewer's own tool, the same for the same run, bounded in size."""

from __future__ import annotations

import inspect
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import rerun as rr
from make_map import (
    CAMERAS,
    make_attempts,
    make_frame,
    make_map,
    make_observations,
    make_poses,
    make_result,
    make_truth,
)
from make_summary import summarize
from read_recording import chunks, column, entities, rerun_tool
from rerun.chunk import RrdReader

from slam_init.errors import OutputError, SourceError
from slam_init.recording import recorder as recording
from slam_init.recording.images import reduced
from slam_init.recording.layout import SERIES
from slam_init.recording.paths import dashes
from slam_init.recording.recorder import Recorder, RerunRecorder
from slam_init.recording.text import attempt_markdown, summary_markdown
from slam_init.types.camera import Camera
from slam_init.types.initial_map import Keyframe


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def tell(recorder, model="pinhole", color=True):
    """A whole run: frames, attempts, a map, a frame after it, a summary."""
    map_ = make_map(model)
    observations = make_observations(map_, model)
    evidence = {"parallax_px": 2.5, "direction_bound_deg": 7.0, "direction_shared_deg_gate": 5.0}
    attempts = [replace(attempt, evidence=attempt.evidence | evidence) for attempt in make_attempts(map_)]
    for i, seen in enumerate(observations):
        recorder.frame(make_frame(seen.frame, seen.timestamp_s, seen.name, color), seen)
        if seen is observations[-1]:
            recorder.initialized(map_, observations)
        if i > 0:
            recorder.attempt(attempts[i - 1])
    later = replace(observations[-1], frame=32, timestamp_s=observations[-1].timestamp_s + 1 / 30)
    recorder.frame(make_frame(32, later.timestamp_s, later.name, color), later)
    recorder.continued(Keyframe(32, later.timestamp_s, later.name, make_poses(5)[4]))
    recorder.summary(summarize(make_result(map_)))
    recorder.close()
    return map_


def record(path, model="pinhole", color=True):
    map_ = make_map(model)
    tell(RerunRecorder(path, CAMERAS[model], "arc", make_truth(map_), seed=3), model, color)
    return map_


@pytest.mark.parametrize(("model", "color"), [("pinhole", True), ("radtan", False), ("fisheye", True)])
def test_a_whole_run_is_there_and_the_file_is_sound(tmp_path, model, color):
    path = tmp_path / "recording.rrd"
    map_ = record(path, model, color)
    assert rerun_tool("verify", path).returncode == 0
    keyframes = {f"/world/keyframes/{k.frame}" for k in map_.keyframes}
    assert keyframes | {
        "/world/camera",
        "/world/camera/image",
        "/world/camera/image/keypoints",
        "/world/points",
        "/world/trajectory/est",
        "/world/trajectory/gt",
        "/pairs/image",
        "/pairs/image/inliers",
        "/pairs/verdict",
        "/stats/counts/tracks",
        "/stats/parallax/median",
        "/stats/direction/gate",
        "/stats/bundle/error",
        "/log",
        "/summary",
    } <= entities(path)
    assert column(path, "/log", "TextLog:level") == [["WARN"], ["WARN"], ["INFO"], ["INFO"]]


def test_the_map_is_there_before_and_after_bundle_adjustment(tmp_path):
    map_ = record(tmp_path / "a.rrd")
    stages = dict(
        zip(
            column(tmp_path / "a.rrd", "/world/points", "stage"),
            column(tmp_path / "a.rrd", "/world/points", "Points3D:positions"),
            strict=True,
        )
    )
    np.testing.assert_allclose(stages[0], map_.points_before, atol=1e-6)
    np.testing.assert_allclose(stages[1], map_.points, atol=1e-6)
    errors = column(tmp_path / "a.rrd", "/stats/bundle/error", "Scalars:scalars")
    assert errors == [[error] for error in map_.bundle_errors]


def test_the_ground_truth_of_a_perfect_map_lies_on_the_estimate(tmp_path):
    map_ = record(tmp_path / "a.rrd")
    dashes = column(tmp_path / "a.rrd", "/world/trajectory/gt", "LineStrips3D:strips")[0]
    truth, path = np.concatenate(dashes), np.array([k.world_from_cam.t for k in map_.keyframes])
    np.testing.assert_allclose([truth[0], truth[-1]], path[[0, -1]], atol=1e-6)
    off = [min(distance_to_segment(point, a, b) for a, b in pairwise(path)) for point in truth]
    assert max(off) < 1e-6


def distance_to_segment(point, a, b):
    share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(a + share * (b - a) - point)


def test_a_dashed_path_is_half_drawn_and_keeps_its_corners():
    corner = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    drawn = dashes(corner)
    lengths = [np.linalg.norm(np.diff(dash, axis=0), axis=1).sum() for dash in drawn]
    np.testing.assert_allclose(lengths, 7 / (2 * len(drawn) - 1))
    assert np.isfinite(np.concatenate(dashes(np.zeros((3, 3))))).all()


def test_the_paths_of_two_maps_are_drawn_while_they_are_kept(tmp_path):
    map_ = make_map()
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "kept") as recorder:
        recorder.undecided((map_, map_))
        recorder.undecided((map_,))
        recorder.undecided(())
    assert rerun_tool("verify", tmp_path / "a.rrd").returncode == 0
    for name, drawn in (("hypothesis1", 2), ("hypothesis2", 1)):
        paths = column(tmp_path / "a.rrd", f"/world/trajectory/{name}", "LineStrips3D:strips")
        assert len(paths) == drawn
        np.testing.assert_allclose(paths[0][0], [k.world_from_cam.t for k in map_.keyframes], atol=1e-6)
    with RerunRecorder(tmp_path / "b.rrd", CAMERAS["pinhole"], "decided") as recorder:
        recorder.undecided(())
    assert not [entity for entity in entities(tmp_path / "b.rrd") if "hypothesis" in entity]


def test_without_ground_truth_there_is_only_the_estimate(tmp_path):
    tell(RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc"))
    assert "/world/trajectory/est" in entities(tmp_path / "a.rrd")
    assert "/world/trajectory/gt" not in entities(tmp_path / "a.rrd")


def test_the_same_run_has_the_same_content_and_another_run_another(tmp_path):
    for name in ("a", "b"):
        record(tmp_path / f"{name}.rrd")
    record(tmp_path / "c.rrd", color=False)
    assert rerun_tool("compare", "--unordered", tmp_path / "a.rrd", tmp_path / "b.rrd").returncode == 0
    assert rerun_tool("compare", "--unordered", tmp_path / "a.rrd", tmp_path / "c.rrd").returncode != 0


def test_the_id_follows_from_the_source_and_the_seed(tmp_path):
    ids = []
    for i, (source, seed) in enumerate([("a", 0), ("a", 0), ("b", 0), ("a", 1)]):
        RerunRecorder(tmp_path / f"{i}.rrd", CAMERAS["pinhole"], source, seed=seed).close()
        ids.append(RrdReader(tmp_path / f"{i}.rrd").recordings()[0].recording_id)
    assert ids[0] == ids[1]
    assert len(set(ids)) == 3


def test_the_wide_image_is_reduced_and_its_keypoints_with_it(tmp_path):
    camera = CAMERAS["pinhole"].scaled(4)
    seen = make_observations(make_map())[0]
    frame = make_frame(0, 0.0, "a.png")
    large = replace(frame, image=frame.image.repeat(4, axis=0).repeat(4, axis=1))
    with RerunRecorder(tmp_path / "a.rrd", camera, "wide") as recorder:
        recorder.frame(large, replace(seen, pixels=(seen.pixels + 0.5) * 4 - 0.5))
    shown = column(tmp_path / "a.rrd", "/world/camera/image/keypoints", "Points2D:positions")[0]
    np.testing.assert_allclose(shown, seen.pixels + 0.5, atol=1e-3)
    assert column(tmp_path / "a.rrd", "/world/camera/image", "Pinhole:resolution") == [[[640, 480]]]


def test_after_many_frames_images_are_thinned_and_tracks_are_not(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_FRAMES_AT_FULL_RATE", 5)
    seen = make_observations(make_map())[0]
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "long") as recorder:
        for i in range(15):
            recorder.frame(make_frame(i, i / 30, "a.png"), replace(seen, frame=i, timestamp_s=i / 30))
    images = [
        frame
        for batch in chunks(tmp_path / "a.rrd", "/world/camera/image")
        if "EncodedImage:blob" in batch.schema.names
        for frame in batch["frame"].to_pylist()
    ]
    assert images == [0, 1, 2, 3, 4, 6, 8, 12]
    assert len(column(tmp_path / "a.rrd", "/stats/counts/tracks", "Scalars:scalars")) == 15


def test_a_pair_of_frames_long_gone_and_one_without_matches_are_drawn_all_the_same(tmp_path):
    attempt = make_attempts(make_map())[0]
    none = np.zeros((0, 2))
    empty = replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool))
    evidence = {"parallax_px": float("nan"), "explained_share": "unknown", "landmarks": 80}
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "gaps") as recorder:
        for told in (attempt, empty, replace(empty, evidence=evidence)):
            recorder.attempt(told)
    assert len(column(tmp_path / "a.rrd", "/pairs/image", "EncodedImage:blob")) == 3
    shown = [series.entity for series in SERIES if f"/{series.entity}" in entities(tmp_path / "a.rrd")]
    scalars = {entity: column(tmp_path / "a.rrd", f"/{entity}", "Scalars:scalars") for entity in shown}
    assert {entity: values for entity, values in scalars.items() if values} == {"stats/counts/landmarks": [[80.0]]}


def test_a_wide_pair_is_stacked_and_a_tall_one_put_side_by_side(tmp_path):
    attempt = make_attempts(make_map())[0]
    for name, height, second in (("wide", 200, (0, 100)), ("tall", 480, (320, 0))):
        camera = replace(CAMERAS["pinhole"], height=height)
        with RerunRecorder(tmp_path / f"{name}.rrd", camera, name) as recorder:
            recorder.attempt(attempt)
        ends = column(tmp_path / f"{name}.rrd", "/pairs/image/inliers/points", "Points2D:positions")[0]
        expected = (attempt.pixels2[attempt.inliers] + 0.5) / 2 + second
        np.testing.assert_allclose(ends[1::2], expected, atol=1e-3)


def test_a_path_that_cannot_be_written_is_told_at_once(tmp_path):
    for path in (tmp_path, tmp_path / "missing" / "a.rrd"):
        with pytest.raises(OutputError, match="cannot write the recording"):
            RerunRecorder(path, CAMERAS["pinhole"], "arc")


def test_the_null_recorder_takes_the_same_calls_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tell(Recorder())
    assert list(tmp_path.iterdir()) == []
    for name, method in inspect.getmembers(Recorder, inspect.isfunction):
        if name in vars(RerunRecorder) and name != "__init__":
            assert inspect.signature(method) == inspect.signature(getattr(RerunRecorder, name))


@pytest.mark.parametrize("error", [SourceError("frame 7: cut off"), KeyboardInterrupt()])
def test_an_error_leaves_the_earlier_recording_and_an_interrupt_what_there_is(tmp_path, error):
    path = tmp_path / "a.rrd"
    path.write_bytes(b"old")
    with pytest.raises(type(error)), RerunRecorder(path, CAMERAS["pinhole"], "arc"):
        assert path.read_bytes() == b"old"
        raise error
    assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]
    if isinstance(error, SourceError):
        assert path.read_bytes() == b"old"
    else:
        assert rerun_tool("verify", path).returncode == 0


@pytest.mark.parametrize("size", [(640, 1), (1, 5000)])
def test_an_image_of_one_line_is_reduced_to_one_line(size):
    camera = Camera("pinhole", *size, 500, 500, 0, 0).scaled(0.1)
    image = reduced(np.zeros(size[::-1], np.uint8), 64)
    assert min(camera.width, camera.height) == 1 == min(image.shape)


def test_a_recording_can_be_closed_twice(tmp_path):
    recorder = RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc")
    recorder.close()
    recorder.close()
    assert rerun_tool("verify", tmp_path / "a.rrd").returncode == 0


def test_the_summary_shows_figures_and_no_times_that_no_two_runs_share():
    text = summary_markdown(summarize(make_result(make_map())))
    assert "| landmarks | 60 |" in text
    assert "| low_parallax | 2 |" in text
    assert "Keyframes: 10, 17, 24, 31" in text
    assert "timing" not in text
    assert "not_initialized: static_camera" in summary_markdown(summarize(make_result(None, "static_camera")))


def test_a_verdict_names_what_was_refused_and_what_would_help():
    refused, *_, accepted = (attempt_markdown(attempt) for attempt in make_attempts(make_map()))
    assert "refused: low_parallax" in refused
    assert "keep translating" in refused
    assert "| parallax_min_deg | 1 |" in refused
    gated = replace(make_attempts(make_map())[0], evidence={"depth_sigma": 0.2, "depth_sigma_gate": 0.1, "spread": 0.5})
    assert "| depth_sigma | 0.2 | 0.1 |" in attempt_markdown(gated)
    assert "| spread | 0.5 |" in attempt_markdown(gated)
    assert "depth_sigma_gate" not in attempt_markdown(gated)
    assert "accepted" in accepted
