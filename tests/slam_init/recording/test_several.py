"""One run for several recorders."""

import inspect

from report_run import report_run

from slam_init.recording.recorder import Recorder, Several


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


def test_no_report_is_left_out():
    reports = {name for name, _ in inspect.getmembers(Recorder, inspect.isfunction) if not name.startswith("_")}
    assert reports <= set(vars(Several))
