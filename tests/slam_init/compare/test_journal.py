"""The journal keeps finished trials on disk and refuses damaged files."""

import tracemalloc

import pytest

from slam_init.compare.journal import Journal
from slam_init.errors import OutputError


@pytest.mark.parametrize("line", ["[]", "1", '"text"', "{"])
def test_a_first_line_without_settings_is_damage(line, tmp_path):
    (tmp_path / "trials.jsonl").write_text(line + "\n")
    with pytest.raises(OutputError, match="line 1 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_a_damaged_line_is_an_error_with_its_number(tmp_path):
    with Journal(tmp_path / "trials.jsonl", {"seed": 0}) as journal:
        journal.append({"source": "a", "method": "b", "start": 0})
    with (tmp_path / "trials.jsonl").open("ab") as file:
        file.write(b"not json\n")
    with pytest.raises(OutputError, match="line 3 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_memory_does_not_hold_the_rows(tmp_path):
    row = {"source": "points:room", "method": "quest", "filler": "x" * 2000}
    with Journal(tmp_path / "trials.jsonl", {}) as journal:
        tracemalloc.start()
        for start in range(2000):
            journal.append(row | {"start": start})
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert sum(1 for _ in journal.rows()) == 2000
    assert grown < 2000 * 500  # a key and a position in the file; the rows take four times as much
