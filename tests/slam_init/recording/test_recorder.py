"""The recorder that ignores all reports."""

import inspect

from report_run import report_run

from slam_init.recording.recorder import Recorder
from slam_init.recording.rerun_recorder import RerunRecorder


def test_a_recorder_takes_all_reports_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report_run(Recorder())
    assert list(tmp_path.iterdir()) == []


def test_all_recorders_have_the_same_reports():
    for name, method in inspect.getmembers(Recorder, inspect.isfunction):
        if name in vars(RerunRecorder) and name != "__init__":
            assert inspect.signature(method) == inspect.signature(getattr(RerunRecorder, name))
