"""Laws of the recording: complete, sound for the viewer's own tool, equal for equal runs, bounded in size."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import rerun as rr
from make_map import CAMERAS, make_attempts, make_frame, make_map, make_observations, make_preview, make_truth
from read_recording import chunks, column, entities, rerun_tool
from report_run import report_run
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from slam_init.errors import OutputError, SourceError
from slam_init.recording import rerun_recorder
from slam_init.recording.layout import SERIES
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.types.camera_pose import CameraPose, PoseKind
from slam_init.types.gates import GateName, at_least, at_most
from slam_init.types.reasons import Verdict


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def record(path, model="pinhole", color=True):
    map_ = make_map(model)
    report_run(RerunRecorder(path, CAMERAS[model], "arc", make_truth(map_), seed=3), model, color)
    return map_


@pytest.mark.parametrize(("model", "color"), [("pinhole", True), ("radtan", False), ("fisheye", True)])
def test_a_recording_holds_the_whole_run_and_passes_verification(tmp_path, model, color):
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
        "/pairs/image/moving",
        "/pairs/verdict",
        "/stats/counts/tracks",
        "/stats/parallax/median",
        "/pairs/evidence",
        "/legend",
        "/stats/risk_log10/bound",
        "/stats/risk_log10/direction",
        "/stats/risk_log10/total",
        "/stats/bundle/error",
        "/log",
        "/summary",
    } <= entities(path)
    assert column(path, "/log", "TextLog:level") == [["WARN"], ["WARN"], ["INFO"], ["INFO"]]


@pytest.mark.parametrize(
    ("start_s", "name", "kind"),
    [
        (0.0, "sensor_time", "duration"),
        (1.4e9, "sensor_date", "timestamp"),
        (1.4e9, "ros2_timestamp", "timestamp"),
        (2000.0, "sensor_time", "duration"),
    ],
)
def test_dates_are_logged_as_dates_and_other_times_as_durations(tmp_path, start_s, name, kind):
    """A bag that is opened beside the recording has dates: only then both lie at the same time."""
    path = tmp_path / "recording.rrd"
    with RerunRecorder(path, CAMERAS["pinhole"], "arc") as recorder:
        for k in range(2):
            frame = make_frame(k, start_s + 0.1 * k, str(k))
            recorder.frame(frame, replace(make_observations(make_map())[0], frame=k))
    # The chunks have no order, and that of the style has no time.
    (batch,) = (batch for batch in chunks(path, "/stats/counts/tracks") if name in batch.schema.names)
    assert str(batch.schema.field(name).type).startswith(kind)


def test_the_layout_has_four_panels_and_no_legend_over_a_plot():
    from slam_init.recording.layout import End, blueprint

    for end in End:
        left, right = blueprint(end).root_container.contents
        assert [len(left.contents), len(right.contents)] == [2, 2]
        assert left.row_shares[0] > 2 * left.row_shares[1]  # the map
        plots = right.contents[1].contents
        views = [
            view for plot in plots for view in (plot, *getattr(plot, "contents", ())) if hasattr(view, "properties")
        ]
        legends = [view.properties["PlotLegend"] for view in views if "PlotLegend" in getattr(view, "properties", ())]
        assert len(legends) > 5
        # Over a hundred frames without a map the parts hide the risk.
        assert plots[0].contents == ["/stats/risk_log10/total", "/stats/risk_log10/bound"]
        assert not any(legend.visible.as_arrow_array().to_pylist()[0] for legend in legends)


def test_a_recording_holds_the_map_before_and_after_bundle_adjustment(tmp_path):
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


def test_both_maps_of_a_plane_have_a_view_of_their_own_and_the_evidence_that_decides(tmp_path):
    map_ = make_map()
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "kept") as recorder:
        recorder.attempt(make_attempts(map_)[0])
        recorder.undecided((map_, map_))
    assert rerun_tool("verify", tmp_path / "a.rrd").returncode == 0
    for name in ("a", "b"):
        points = column(tmp_path / "a.rrd", f"/twins/{name}/points", "Points3D:positions")[0]
        np.testing.assert_allclose(points, map_.points, atol=1e-6)
    assert "one of the maps is right" in column(tmp_path / "a.rrd", "/twins/evidence", "TextDocument:text")[0][0]


def test_matches_are_neither_inliers_nor_outliers_where_no_motion_was_estimated(tmp_path):
    attempt = make_attempts(make_map())[0]
    no = np.zeros(len(attempt.inliers), bool)
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "rotation") as recorder:
        recorder.attempt(replace(attempt, inliers=no, moving=no, window=None, two_view=None, map=None))
    drawn = {
        name: len(column(tmp_path / "a.rrd", f"/pairs/image/{name}/points", "Points2D:positions")[0] or ())
        for name in ("inliers", "outliers", "tracks")
    }
    assert drawn == {"inliers": 0, "outliers": 0, "tracks": 2 * len(no)}


def test_tracks_on_a_moving_body_are_drawn_in_their_frame_and_not_in_the_next(tmp_path):
    map_ = make_map()
    first, second, third, *_ = make_observations(map_)
    attempt = make_attempts(map_)[0]
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "moving") as recorder:
        for seen in (first, second, third):
            recorder.frame(make_frame(seen.frame, seen.timestamp_s, seen.name), seen)
            if seen is second:
                recorder.attempt(attempt)
    shown = column(tmp_path / "a.rrd", "/world/camera/image/moving", "Points2D:positions")
    assert [len(points or ()) for points in shown] == [np.count_nonzero(attempt.moving & ~attempt.inliers), 0]


def test_a_rolling_shutter_is_shown_before_and_after_its_correction(tmp_path):
    seen = make_observations(make_map())[0]
    corrected = seen.pixels + np.array([1.0, -2.0])
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "rolling") as recorder:
        recorder.frame(make_frame(seen.frame, seen.timestamp_s, seen.name), seen)
        recorder.row_times(seen, corrected)
    for name, pixels in (("before", seen.pixels), ("after", corrected)):
        points = column(tmp_path / "a.rrd", f"/world/camera/image/readout/{name}", "Points2D:positions")[0]
        np.testing.assert_allclose(points, pixels + 0.5, atol=1e-3)


def test_without_ground_truth_there_is_only_the_estimate(tmp_path):
    report_run(RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc"))
    assert "/world/trajectory/est" in entities(tmp_path / "a.rrd")
    assert "/world/trajectory/gt" not in entities(tmp_path / "a.rrd")


def test_equal_runs_have_equal_content_and_other_runs_do_not(tmp_path):
    for name in ("a", "b"):
        record(tmp_path / f"{name}.rrd")
    record(tmp_path / "c.rrd", color=False)
    assert rerun_tool("compare", "--unordered", tmp_path / "a.rrd", tmp_path / "b.rrd").returncode == 0
    assert rerun_tool("compare", "--unordered", tmp_path / "a.rrd", tmp_path / "c.rrd").returncode != 0


def test_the_id_depends_on_the_source_and_the_seed_only(tmp_path):
    ids = []
    for i, (source, seed) in enumerate([("a", 0), ("a", 0), ("b", 0), ("a", 1)]):
        RerunRecorder(tmp_path / f"{i}.rrd", CAMERAS["pinhole"], source, seed=seed).close()
        ids.append(RrdReader(tmp_path / f"{i}.rrd").recordings()[0].recording_id)
    assert ids[0] == ids[1]
    assert len(set(ids)) == 3


def test_a_large_image_and_its_keypoints_are_reduced_equally(tmp_path):
    camera = CAMERAS["pinhole"].scaled(4)
    seen = make_observations(make_map())[0]
    frame = make_frame(0, 0.0, "a.png")
    large = replace(frame, image=frame.image.repeat(4, axis=0).repeat(4, axis=1))
    with RerunRecorder(tmp_path / "a.rrd", camera, "wide") as recorder:
        recorder.frame(large, replace(seen, pixels=(seen.pixels + 0.5) * 4 - 0.5))
    shown = column(tmp_path / "a.rrd", "/world/camera/image/keypoints", "Points2D:positions")[0]
    np.testing.assert_allclose(shown, seen.pixels + 0.5, atol=1e-3)
    assert column(tmp_path / "a.rrd", "/world/camera/image", "Pinhole:resolution") == [[[640, 480]]]


def test_of_many_frames_only_some_images_are_kept_but_all_tracks(tmp_path, monkeypatch):
    monkeypatch.setattr(rerun_recorder, "FRAMES_AT_FULL_RATE", 5)
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


def test_a_pair_is_drawn_also_without_its_images_and_without_matches(tmp_path):
    attempt = make_attempts(make_map())[0]
    none = np.zeros((0, 2))
    empty = replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool), moving=np.zeros(0, bool))
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "gaps") as recorder:
        recorder.attempt(attempt)
        recorder.attempt(empty)
    assert len(column(tmp_path / "a.rrd", "/pairs/image", "EncodedImage:blob")) == 2


def test_figures_that_an_attempt_lacks_or_that_are_not_finite_are_not_plotted(tmp_path):
    attempt = make_attempts(make_map())[0]
    landmarks = at_least(GateName.LANDMARKS, 80, 50, Verdict.TOO_FEW_LANDMARKS)
    risk = replace(at_most(GateName.RISK, float("nan"), 0.005, Verdict.LOW_PARALLAX), threshold=float("nan"))
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "gaps") as recorder:
        recorder.attempt(replace(attempt, preview=None, window=None, gates=()))
        nan = replace(make_preview(parallax_px=float("nan")), parallax_share=float("nan"))
        terms = ("risk", "risk_direction", "risk_rival", "risk_rotation", "risk_moving")
        window = replace(attempt.window, direction_sigma_deg=float("nan"), **dict.fromkeys(terms, float("nan")))
        recorder.attempt(replace(attempt, preview=nan, window=window, gates=(landmarks, risk)))
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


def test_a_path_that_cannot_be_written_is_an_error_at_once(tmp_path):
    for path in (tmp_path, tmp_path / "missing" / "a.rrd"):
        with pytest.raises(OutputError, match="cannot write the recording"):
            RerunRecorder(path, CAMERAS["pinhole"], "arc")


@pytest.mark.parametrize("error", [SourceError("frame 7: cut off"), KeyboardInterrupt()])
def test_an_error_leaves_the_earlier_recording_and_an_interrupt_the_new_one(tmp_path, error):
    path = tmp_path / "a.rrd"
    path.write_bytes(b"old")
    with pytest.raises(type(error)), RerunRecorder(path, CAMERAS["pinhole"], "arc") as recorder:
        assert path.read_bytes() == b"old"
        recorder.frame(make_frame(0, 0.0, "a.png"), make_observations(make_map())[0])
        raise error
    assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]
    if isinstance(error, SourceError):
        assert path.read_bytes() == b"old"
    else:
        assert rerun_tool("verify", path).returncode == 0


def test_a_recording_can_be_closed_twice(tmp_path):
    recorder = RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc")
    recorder.close()
    recorder.close()
    assert rerun_tool("verify", tmp_path / "a.rrd").returncode == 0


def test_the_camera_turns_while_there_is_no_map(tmp_path):
    turned = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix()
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc") as recorder:
        recorder.frame(make_frame(0, 0.0, "0.png"), make_observations(make_map())[0])
        recorder.waiting(CameraPose(PoseKind.PROVISIONAL, turned, 0.3, np.ones(3), 2.0, 0))
    [matrix] = column(tmp_path / "a.rrd", "/world/camera", "Transform3D:mat3x3")
    # Rerun stores matrices by columns, so that the transposed matrix is the one that was given.
    np.testing.assert_allclose(np.reshape(matrix, (3, 3)), turned, atol=1e-6)
    assert column(tmp_path / "a.rrd", "/stats/direction/rotation", "Scalars:scalars") == [[0.3]]


def test_a_map_that_has_grown_is_drawn_with_its_new_keyframes(tmp_path):
    map_ = make_map()
    later = replace(map_.keyframes[-1], frame=40)
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc") as recorder:
        recorder.frame(make_frame(0, 0.0, "0.png"), make_observations(make_map())[0])
        recorder.initialized(map_, [])
        recorder.refined(replace(map_, keyframes=(*map_.keyframes, later), points=2 * map_.points))
    assert "/world/keyframes/40" in entities(tmp_path / "a.rrd")
    drawn = column(tmp_path / "a.rrd", "/world/points", "Points3D:positions")
    assert any(np.allclose(points, 2 * map_.points, atol=1e-6) for points in drawn)
