"""Robust estimators on pairs of real images: failures are counted, and the program writes the tables that it prints."""

from __future__ import annotations

import numpy as np
from make_chessboard import MOTION, write_chessboard

from tests.benchmarks import real_pairs
from tests.benchmarks.image_pairs import ImagePair, chessboard_pairs
from tests.benchmarks.real_pairs import Group, run_group


def test_a_pair_with_too_few_matches_counts_as_failed(tmp_path):
    write_chessboard(tmp_path, np.random.default_rng(0))
    (whole,) = chessboard_pairs(tmp_path)
    few = ImagePair(whole.bearings1[:9], whole.bearings2[:9], whole.distances[:9], 500.0, MOTION)
    outcome = run_group(Group("g", lambda: iter([whole, few]), False), ["quest"], 2.0)
    good, failed = outcome.answers["quest"]
    assert good.kept_error_deg < 1
    assert (failed.kind, failed.error_deg) == ("none", np.inf)
    assert (outcome.matches, outcome.true_shares) == ([54, 9], [1.0])


def test_the_program_writes_tables_of_the_sets_and_needs_data(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert real_pairs.main([]) == 2
    assert "SLAM_INIT_DATA" in capsys.readouterr().err
    (tmp_path / "planar" / "opencv_chessboard").mkdir(parents=True)
    write_chessboard(tmp_path / "planar" / "opencv_chessboard", np.random.default_rng(0))
    assert real_pairs.main(["--methods", "quest", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "out" / "real_pairs.md").read_text()
    assert "planar/opencv_chessboard, corners" in shown
