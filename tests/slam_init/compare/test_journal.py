"""The journal keeps finished trials on disk and refuses damaged files."""

import json
import tracemalloc

import pytest

from slam_init.compare.rows import COLUMNS, Journal, TrialRow, parse_row, row_text
from slam_init.errors import OutputError


def row(**values):
    given = {"source": "points:room", "method": "quest", "start": 0, "outcome": "none"}
    return TrialRow(**given | {"group": "points:room", "frames_limit": 12} | values)


@pytest.mark.parametrize("line", ["[]", "1", '"text"', "{"])
def test_a_first_line_without_settings_is_damage(line, tmp_path):
    (tmp_path / "trials.jsonl").write_text(line + "\n")
    with pytest.raises(OutputError, match="line 1 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_a_damaged_line_is_an_error_with_its_number(tmp_path):
    with Journal(tmp_path / "trials.jsonl", {"seed": 0}) as journal:
        journal.append(row())
    with (tmp_path / "trials.jsonl").open("ab") as file:
        file.write(b"not json\n")
    with pytest.raises(OutputError, match="line 3 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_memory_does_not_hold_the_rows(tmp_path):
    with Journal(tmp_path / "trials.jsonl", {}) as journal:
        tracemalloc.start()
        for start in range(2000):
            journal.append(row(start=start, reason="x" * 2000))
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert sum(1 for _ in journal.rows()) == 2000
    assert grown < 2000 * 500  # a key and a position in the file; the rows take four times as much


def test_a_row_is_read_as_it_was_written():
    written = row(outcome="correct", strict=True, ate=0.25, landmarks=40, keyframes="0 4", frame_median_ms=1.5)
    assert parse_row(row_text(written)) == written
    assert list(json.loads(row_text(written))) == list(COLUMNS)


def test_a_row_of_another_version_is_read_without_its_unknown_columns_and_with_none_for_missing_ones():
    stored = json.loads(row_text(row(kept_truth=True))) | {"unknown": 1}
    del stored["kept_truth"]
    assert parse_row(json.dumps(stored)) == row()


def test_rows_that_are_not_current_are_run_again_and_the_later_row_of_a_trial_is_valid(tmp_path):
    path = tmp_path / "trials.jsonl"
    with Journal(path, {}) as journal:
        journal.append(row(judged_by="former"))
        journal.append(row(start=10, judged_by="current"))
    for _ in range(2):
        with Journal(path, {}, lambda row: row.judged_by == "current") as journal:
            if row().key not in journal:
                journal.append(row(judged_by="current"))
            assert [each.judged_by for each in journal.rows()] == ["current", "current"]
    assert len(path.read_text().splitlines()) == 4


@pytest.mark.parametrize(
    ("column", "value"),
    [("source", None), ("start", "0"), ("start", True), ("outcome", "lost"), ("strict", 1), ("ate", "0.1")],
)
def test_a_row_with_a_value_of_the_wrong_type_is_damage(column, value, tmp_path):
    lines = [json.dumps({"schema": 2}), json.dumps(json.loads(row_text(row())) | {column: value})]
    (tmp_path / "trials.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(OutputError, match="line 2 is damaged"):
        Journal(tmp_path / "trials.jsonl", {})
