"""Restarting after a loss: one map for each segment, with the same camera, tracks and readout."""

import json
from dataclasses import replace

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA, cloud, observe
from make_source import synth
from written import contents

from slam_init.config import Config
from slam_init.errors import SourceError
from slam_init.initializer import Initializer
from slam_init.mapping.follower import follow
from slam_init.methods import make_initializer
from slam_init.output.results import load_graph
from slam_init.recording.recorder import Recorder
from slam_init.runner import run
from slam_init.types.refusal import Verdict


def scene(seed, first_frame, count=10, first_id=0):
    """The tracks of a camera that moves on an arc before 200 points."""
    rng = np.random.default_rng(seed)
    tracks = observe(CAMERA, make_poses(count), cloud(rng, 200), 0.3, rng, range(first_frame, first_frame + count))
    return [replace(one, track_ids=one.track_ids + first_id) for one in tracks]


def fed(initializer, tracks):
    for one in tracks:
        if initializer.process_tracks(one):
            return initializer.result.map
    return None


@pytest.mark.parametrize("method", ["quest", "orb-slam3"])
def test_after_a_reset_the_next_map_is_a_segment_of_its_own(method):
    initializer = make_initializer(method, CAMERA, Config())
    first = fed(initializer, scene(1, 0))
    assert initializer.result.segments == ()
    tracks = scene(2, 40, first_id=5000)
    initializer.reset()
    assert not initializer.status
    assert initializer.result.reason == Verdict.TOO_FEW_FRAMES or method != "quest"
    second = fed(initializer, tracks)
    segments = initializer.result.segments
    assert [segment.map for segment in segments] == [first, second]
    assert segments[1].first_frame in (tracks[0].frame, tracks[0].frame - 1, segments[0].map.keyframes[-1].frame)
    assert second.keyframes[0].frame >= 40
    assert not set(first.track_ids) & set(second.track_ids)


def test_a_reset_keeps_the_tracks_since_a_frame():
    initializer, tracks = Initializer(CAMERA), scene(1, 0, count=14)
    first = fed(initializer, tracks)
    newest = first.keyframes[-1].frame
    initializer.reset(since=newest - 1)
    assert [observed.frame for observed in initializer.history] == [newest - 1, newest]
    assert initializer.frames_read == 2
    second = fed(initializer, tracks[newest + 1 :])
    assert second.keyframes[0].frame == newest - 1
    assert set(second.track_ids) & set(first.track_ids)


def test_a_reset_keeps_the_readout_and_the_clock():
    initializer = Initializer(CAMERA)
    fed(initializer, scene(1, 0))
    initializer.intake.shutter.readout_s = 0.02
    initializer.reset()
    assert initializer.intake.shutter.readout_s == 0.02
    with pytest.raises(Exception, match="time stamp"):
        initializer.process_tracks(replace(scene(1, 60)[0], timestamp_s=0.0))


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """A run over a video with a cut at frame 14."""
    source = synth("room", width=240, height=180, frames=28, cut=14, slow_start=1)
    out = tmp_path_factory.mktemp("cut") / "out"
    result, summary = run(source, source.camera, Config(), out=out, restart=True, export=["scene"])
    return source, result, summary, out


def test_a_map_is_lost_at_a_cut_and_another_one_begins_there(cut):
    _, result, summary, _ = cut
    first, second = result.segments
    assert first.lost_at == second.first_frame == 14
    assert second.lost_at is None
    assert first.map is result.map
    assert all(keyframe.frame < 14 for keyframe in (*first.map.keyframes, *first.located))
    assert all(keyframe.frame >= 14 for keyframe in (*second.map.keyframes, *second.located))
    assert second.located[-1].frame == 27
    for segment in summary.segments:
        assert segment.ground_truth.rotation_error_deg < 5
        assert segment.ground_truth.direction_error_deg < 15


def test_each_map_has_a_folder_and_the_summary_lists_them(cut):
    _, result, summary, out = cut
    files = set(contents(out))
    assert {"summary.json", "config.toml", "recording.rrd", "overview.png"} == {
        name for name in files if "/" not in name
    }
    for number, segment in enumerate(result.segments, start=1):
        folder = out / f"segment-{number:03d}"
        assert len(np.loadtxt(folder / "trajectory.txt")) == len(segment.map.keyframes)
        assert len(np.loadtxt(folder / "continued.txt")) == len(segment.located)
        views = {one.frame for one in (*segment.map.keyframes, *segment.located)}
        assert len(list((folder / "scene" / "images").iterdir())) == len(views)
        graph, values = load_graph(folder)
        assert graph.error(values) == pytest.approx(segment.map.graph.error(segment.map.values), rel=1e-6)
    with pytest.raises(SourceError, match="segment-001"):
        load_graph(out)
    written = json.loads((out / "summary.json").read_text())
    assert [segment["folder"] for segment in written["segments"]] == ["segment-001", "segment-002"]
    assert written["keyframes"] == written["segments"][0]["keyframes"]
    assert written == summary.as_dict()


def test_a_map_whose_landmarks_are_all_out_of_view_is_lost_at_once(room_fed):
    blank = [replace(frame, image=np.full_like(frame.image, 90)) for frame in room_fed.following]
    good, bad = room_fed.following[:2], blank[2:]
    continued = follow(room_fed.result.map, room_fed.tracker, iter([*good, *bad]), None, Recorder(), until_lost=True)
    assert continued.lost_at == bad[0].index
    assert [keyframe.frame for keyframe in continued.keyframes] == [frame.index for frame in good]
    assert continued.frames == 3
