"""The tables of the speed: robust estimates and starts."""

import pytest
from comparisons import table_cells

from tests.benchmarks.speed.__main__ import main
from tests.benchmarks.speed.robust import estimates_table, robust_table
from tests.benchmarks.speed.start import Start, start_table


def test_estimates_show_the_median_the_99th_percentile_and_their_ratios():
    times = {"quest": [float(one) for one in range(1, 102)], "PoseLib min 100": [2.0] * 101}
    (row, empty) = table_cells(estimates_table({"case": times, "nothing": {"quest": [], "PoseLib min 100": []}}))
    assert row == ["case", "101", "51.00", "100.00", "2.00", "2.00", "25.50", "50.00"]
    assert empty[1:] == ["0", *["-"] * 6]


def test_real_pairs_that_are_absent_are_named(tmp_path):
    pytest.importorskip("poselib", reason="the extra poselib is not installed")
    table = robust_table(1, tmp_path)
    assert "Left out, because the folder of data does not hold them: tartanair/hospital_clip" in table
    assert "real pairs" not in table


def test_starts_show_medians_and_the_ratio_to_the_flow():
    table = start_table({"first pose, warm": [Start(1.0, 0.5), Start(3.0, 0.7), Start(2.0, 0.6)]}, 4.0)
    assert table_cells(table) == [["first pose, warm", "3", "2.00", "0.60", "150"]]


def test_the_program_runs_a_part_of_its_tables(capsys, tmp_path, monkeypatch):
    pytest.importorskip("poselib", reason="the extra poselib is not installed")
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert main(["--only", "robust", "--repetitions", "1", "--out", str(tmp_path / "speed.md")]) == 0
    text = capsys.readouterr().out
    assert text == (tmp_path / "speed.md").read_text()
    assert "## Robust estimates" in text
    with pytest.raises(SystemExit):
        main(["--only", "nothing"])
