"""The program of the study."""

from tests.benchmarks import study


def test_the_program_prints_and_writes_the_table_and_does_not_repeat_finished_trials(tmp_path, capsys):
    options = ["--out", str(tmp_path), "--trials", "1", "--part", "general", "--methods", "essential-8pt,stella"]
    assert study.main(options) == 0
    shown = capsys.readouterr().out
    assert shown.strip() == (tmp_path / "general.md").read_text().strip()
    trials = (tmp_path / "general" / "trials.jsonl").read_bytes()
    assert study.main(options) == 0
    assert capsys.readouterr().out == shown
    assert (tmp_path / "general" / "trials.jsonl").read_bytes() == trials
