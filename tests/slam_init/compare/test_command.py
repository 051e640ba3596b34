"""The command ``slam-init compare``."""

import pytest
from comparisons import rows_of

from slam_init.cli import main

DATA_SET = "python:slam_init.examples.add_a_data_set:Poster"


def test_the_command_writes_tables_a_page_and_recordings_of_the_example_data_set_and_method(tmp_path, capsys):
    methods = ["quest-two-view", "slam_init.examples.add_a_method:MedianParallax"]
    options = ["--every", "30", "--limit-frames", "12", "--backend", "sequential", "--recordings"]
    assert main(["compare", DATA_SET, *options, "--methods", ",".join(methods), "--out", str(tmp_path)]) == 0
    assert "images, moving camera" in capsys.readouterr().out
    rows = rows_of(tmp_path)
    assert [(row["source"], row["method"], row["outcome"]) for row in rows] == [
        (DATA_SET, method, "correct") for method in methods
    ]
    names = [path.name for path in sorted(tmp_path.rglob("*.rrd"))]
    assert names == ["quest-two-view.rrd", "side-by-side.rrd", "slam_init.examples.add_a_method-MedianParallax.rrd"]
    assert not list(tmp_path.rglob("*.npz"))  # the snapshots are removed after the recording of all methods


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["points:room", "--methods", "magic"],
        ["points:room", "--methods", "stella,stella"],
        ["points:room", "--backend", "spark"],
        ["points:room", "--jobs", "0"],
        ["nowhere"],
        ["python:nowhere:nothing"],
    ],
)
def test_a_wrong_command_is_reported_in_one_line(arguments, tmp_path, capsys):
    assert main(["compare", *arguments, "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("slam-init: error: ")
    assert message.count("\n") == 1
