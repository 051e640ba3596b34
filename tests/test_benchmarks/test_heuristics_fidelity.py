"""The table that compares the heuristics with their systems."""

import pytest

from tests.benchmarks import heuristics_fidelity
from tests.benchmarks.heuristics_fidelity import fisher_p


def test_fishers_test_is_that_of_the_textbook():
    """The lady tasting tea: three of four cups correct."""
    assert fisher_p(3, 4, 1, 4) == pytest.approx(34 / 70)
    assert fisher_p(4, 4, 0, 4) == pytest.approx(2 / 70)
    assert fisher_p(7, 50, 7, 50) == 1


def test_the_program_prints_the_table_that_it_writes(tmp_path, capsys):
    out = tmp_path / "new"
    assert heuristics_fidelity.main(["--scenes", "2", "--methods", "stella", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert (out / "heuristics_fidelity.md").read_text() == printed
    assert "| general 0.03" in printed
    with pytest.raises(SystemExit):
        heuristics_fidelity.main(["--methods", "quest"])
