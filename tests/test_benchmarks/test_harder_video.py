"""Laws of the copies of video that are made harder: their ground truth stays true."""

import numpy as np
import pytest

from slam_init import open_source
from slam_init.compare.rows import TrialRow
from tests.benchmarks.harder_video import VARIANTS, table, write
from tests.benchmarks.options import choice_list


@pytest.mark.parametrize("name", ["backward", "the middle 60 %", "half the size with JPEG 30"])
def test_tracks_of_a_copy_keep_to_its_ground_truth(tmp_path, name):
    source = open_source("synth:room?frames=8&width=320&height=240")
    write(source, VARIANTS[name], tmp_path / "copy")
    copy = open_source(str(tmp_path / "copy"))
    assert len(copy) == len(source) and (np.diff(copy.timestamps_s) > 0).all()
    assert epipolar_error_px(copy) < 0.5


@pytest.mark.parametrize("name", list(VARIANTS))
def test_each_variant_can_be_chosen_alone(name):
    assert choice_list(list(VARIANTS))(name) == [name]


def epipolar_error_px(source):
    """Median distance of the tracks of the first and the last frame from the epipolar lines of the truth."""
    from slam_init.config import Config
    from slam_init.frontend.tracks import Tracker

    tracker = Tracker(source.camera, Config().tracking)
    seen = [tracker.track(frame) for frame in source.frames()]
    first, last = seen[0], seen[-1]
    _, i, j = np.intersect1d(first.track_ids, last.track_ids, return_indices=True)
    poses = [source.groundtruth.at(one.timestamp_s) for one in (first, last)]
    moved = poses[1].inverse() @ poses[0]
    normals = np.cross(moved.t, first.bearings[i] @ moved.R.T)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert len(i) > 50
    return np.median(np.abs(np.sum(normals * last.bearings[j], axis=1))) * source.camera.focal_px


def test_the_table_counts_outcomes_and_a_start_without_a_right_map_waits_for_its_limit():
    same = {"source": "room", "method": "quest", "group": "room", "frames_limit": 40}
    rows = [
        TrialRow(start=0, outcome="correct", frames_to_accept=3, **same),
        TrialRow(start=1, outcome="false", frames_to_accept=5, **same),
        TrialRow(start=2, outcome="none", **same),
    ]
    line = table([("dark", "room", row) for row in rows], ["quest"]).splitlines()[2]
    assert "1/1/1 27.33" in line
    assert "all" in line
