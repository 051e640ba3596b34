"""The recorder that ignores all reports, and one run for several recorders."""

import inspect

from report_run import report_run

from slam_init.recording.recorder import Recorder, Several
from slam_init.recording.rerun_recorder import RerunRecorder


class Noting(Recorder):
    """Notes which reports it gets."""

    def __init__(self):
        self.noted = []

    def __getattribute__(self, name):
        if name in vars(Recorder) and not name.startswith("_"):
            self.noted.append(name)
        return super().__getattribute__(name)


def test_each_recorder_gets_each_report_in_the_same_order():
    alone, first, second = Noting(), Noting(), Noting()
    report_run(alone)
    report_run(Several(first, second))
    assert first.noted == second.noted == alone.noted


def test_all_recorders_have_the_same_reports():
    for name, method in inspect.getmembers(Recorder, inspect.isfunction):
        assert name in vars(Several) or name.startswith("_")
        if name in vars(RerunRecorder) and name != "__init__":
            assert inspect.signature(method) == inspect.signature(getattr(RerunRecorder, name))
