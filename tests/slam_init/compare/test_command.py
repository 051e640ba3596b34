"""The command ``slam-init compare``."""

import pytest
from comparisons import METHODS, rows_of

from slam_init.cli import main
from slam_init.compare.command import chosen_methods, main_table

DATA_SET = "python:docs/examples/add_a_data_set.py:Poster"


def test_the_command_writes_tables_a_page_and_recordings_of_the_example_data_set_and_method(tmp_path, capsys):
    methods = ["quest", "add_a_method:MedianParallax"]
    options = ["--every", "30", "--min-left", "15", "--limit-frames", "16", "--backend", "sequential", "--recordings"]
    assert main(["compare", DATA_SET, *options, "--methods", ",".join(methods), "--out", str(tmp_path)]) == 0
    assert "images, moving camera" in capsys.readouterr().out
    rows = rows_of(tmp_path)
    assert [(row["source"], row["method"], row["outcome"]) for row in rows] == [
        (DATA_SET, method, "correct") for method in sorted(methods)
    ]
    names = {path.name for path in tmp_path.rglob("*.rrd")}
    assert names == {"quest.rrd", "side-by-side.rrd", "add_a_method-MedianParallax.rrd"}
    assert not list(tmp_path.rglob("*.npz"))  # the snapshots are removed after the recording of all methods


def test_by_default_each_installed_method_is_compared_under_one_name():
    names = chosen_methods(None)
    assert "essential-5pt" in names
    assert "magsac" not in names
    assert chosen_methods("magsac,quest") == ("magsac", "quest")


def test_the_tables_fit_a_terminal_and_tell_something_in_each_column(finished):
    text = main_table(finished[1])
    assert max(map(len, text.splitlines())) <= 120
    for table in text.split("\n\n"):
        rows = [line.strip("|").split("|") for line in table.splitlines()]
        columns = list(zip(*rows[2:], strict=True))
        assert not any(set("".join(column).split()) <= {"-"} for column in columns), rows[0]


def test_the_text_holds_the_wait_of_each_method_and_its_differences(finished):
    text = main_table(finished[1])
    assert "wait (frames)" in text
    assert f"wait of {METHODS[0]} minus that of" in text


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["points:room", "--methods", "magic"],
        ["points:room", "--methods", "stella,stella"],
        ["points:room", "--backend", "spark"],
        ["points:room", "--jobs", "0"],
        ["points:room", "--min-left", "1"],
        ["nowhere"],
        ["python:nowhere:nothing"],
    ],
)
def test_a_wrong_command_is_reported_in_one_line(arguments, tmp_path, capsys):
    assert main(["compare", *arguments, "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("slam-init: error: ")
    assert message.count("\n") == 1
