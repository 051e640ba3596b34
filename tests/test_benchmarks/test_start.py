"""The benchmark of the start: what a process reports, and the medians of the table."""

from __future__ import annotations

import pytest

from tests.benchmarks.start import Started, started, table


def test_a_program_is_timed_from_where_it_says(tmp_path):
    spinning = "end = time.process_time() + 0.2\nwhile time.process_time() < end:\n    pass\n"
    whole = started(spinning, tmp_path, 2.0)
    assert whole.cpu_s >= 0.2
    assert whole.clock_s >= whole.cpu_s - 0.01
    assert started(f"{spinning}before = clocks()", tmp_path, 2.0).cpu_s < 0.2


def test_a_program_that_fails_is_told(tmp_path):
    with pytest.raises(RuntimeError, match="code 3"):
        started("raise SystemExit(3)", tmp_path, 2.0)


def test_the_table_has_medians_and_ratios():
    rows = table({"run": [Started(cpu_s, 4.0, 2.0) for cpu_s in (1.0, 2.0, 9.0)]}).splitlines()
    cells = [cell.strip() for cell in rows[2].strip("| ").split("|")]
    assert cells[0] == "run"
    assert [float(cell.rstrip("%")) for cell in cells[1:]] == [2.0, 4.0, 50.0, 1000.0]
