"""The journal keeps finished trials on disk and refuses damaged files."""

import json

import pytest

from slam_init.compare.rows import COLUMNS, Journal, TrialRow
from slam_init.errors import OutputError
from tests.benchmarks.tables import read_journal


def row(**values):
    given = {"source": "points:room", "method": "quest", "start": 0, "outcome": "none"}
    return TrialRow(**given | {"group": "points:room", "frames_limit": 12} | values)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "trials.jsonl"


def test_a_file_that_is_no_journal_is_refused(path):
    for line in ("1", '"text"', "{", "[" * 100_000):
        path.write_text(line + "\n")
        with pytest.raises(OutputError, match="line 1 is damaged"):
            Journal(path, {"seed": 0})
    for line in ("[]", "{}", '{"schema": 1}'):
        path.write_text(line + "\n")
        with pytest.raises(OutputError, match="another version"):
            Journal(path, {"seed": 0})


def test_a_line_that_is_no_row_is_damage_with_its_number(path):
    wrong = {"source": None, "start": "0", "outcome": "lost", "strict": 1, "ate": "0.1"}
    damaged = [{**json.loads(row().text()), column: value} for column, value in wrong.items()]
    for line in ("not json", "[" * 100_000, *map(json.dumps, damaged), json.dumps(damaged[1] | {"start": True})):
        path.write_text(f'{{"schema": 3, "seed": 0}}\n{row().text()}\n{line}\n')
        with pytest.raises(OutputError, match="line 3 is damaged"):
            Journal(path, {"seed": 0})


def test_a_row_is_read_as_it_was_written_and_columns_of_other_versions_do_not_matter(path):
    written = row(outcome="correct", strict=True, ate=0.25, landmarks=40, keyframes="0 4", frame_median_ms=1.5, risk=0)
    assert list(json.loads(written.text())) == list(COLUMNS)
    stored = json.loads(row(start=10, kept_truth=True).text()) | {"unknown": 1}
    del stored["kept_truth"]
    with Journal(path, {}) as journal:
        journal.append(written)
    with path.open("a") as file:
        file.write(json.dumps(stored) + "\n")
    assert read_journal(path) == [written, row(start=10)]


def test_an_incomplete_last_line_is_removed_and_the_next_row_stands_in_its_place(path):
    for torn in (row(start=10).text()[:40], "\0" * 30 + "\n"):
        with Journal(path, {}) as journal:
            journal.append(row())
        with path.open("a") as file:
            file.write(torn)
        with Journal(path, {}) as journal:
            journal.append(row(start=20))
        assert [one.start for one in read_journal(path)] == [0, 20]
        path.unlink()


def test_rows_that_are_not_current_are_run_again_and_the_later_row_of_a_trial_is_valid(path):
    with Journal(path, {}) as journal:
        journal.append(row(evaluated_by="former"))
        journal.append(row(start=10, evaluated_by="current"))
    for _ in range(2):
        with Journal(path, {}, lambda row: row.evaluated_by == "current") as journal:
            if row().key not in journal.rows:
                journal.append(row(evaluated_by="current"))
            assert [each.evaluated_by for each in journal.rows.values()] == ["current", "current"]
    assert len(path.read_text().splitlines()) == 4
