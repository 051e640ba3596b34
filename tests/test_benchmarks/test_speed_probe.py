"""The program that measures a checkout: ratios to the fixed piece of work, without the tasks that it cannot do."""

import json
from pathlib import Path

import pytest

import slam_init
from tests.benchmarks import speed_probe

TREE = Path(slam_init.__file__).resolve().parent.parent


def test_a_task_that_fails_is_left_out_and_the_others_are_ratios(monkeypatch, capsys):
    def fails():
        raise AttributeError("this commit has none")

    monkeypatch.setattr(speed_probe, "_flow_s", lambda: 0.5)
    monkeypatch.setattr(speed_probe, "tasks", lambda: iter([("works", lambda: 1.0), ("fails", fails)]))
    speed_probe.main(str(TREE))
    shown = capsys.readouterr()
    assert json.loads(shown.out) == {"works": 2.0}
    assert "this commit has none" in shown.err


def test_modules_of_another_checkout_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(speed_probe, "tasks", lambda: iter([]))
    with pytest.raises(RuntimeError, match="were measured, not those of"):
        speed_probe.main(str(tmp_path))


def test_the_names_of_the_tasks_are_distinct():
    names = [name for name, _ in speed_probe.tasks()]
    assert len(set(names)) == len(names) > 5
