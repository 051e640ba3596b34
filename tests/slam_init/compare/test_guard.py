"""No process of a comparison outlives it, and a method of somebody else costs its own trial only."""

import os
import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from comparisons import SOURCES
from process_tree import MARK, left_over, new_mark, processes_with

from slam_init.compare.isolation import Answer, check_method, isolated_trial
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Settings, Trial
from slam_init.errors import ConfigError

HOSTILE = "hostile"

PARENT = f"""
from slam_init.compare.isolation import isolated_trial
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Settings, Trial
source = describe_sources({SOURCES[:1]!r})[0]
isolated_trial(Trial(source, "stella", 0), Settings())
print("ready", flush=True)
isolated_trial(Trial(source, "{HOSTILE}:LoopsInC", 0), Settings())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_a_parent_that_is_killed(number):
    mark = new_mark()
    environment = os.environ | {MARK: mark, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    parent = subprocess.Popen([sys.executable, "-c", PARENT], env=environment, stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"ready\n"
    assert len(processes_with(mark)) == 3  # the parent, the guard, the process of the trials
    parent.send_signal(number)
    parent.wait()
    parent.stdout.close()
    assert left_over(mark) == []


def test_what_a_method_changes_or_sends_costs_its_own_trial(tmp_path, monkeypatch):
    monkeypatch.setenv("SLAM_INIT_PICKLE_FILE", str(tmp_path / "unpickled"))
    source = describe_sources(SOURCES[:1])[0]
    good = isolated_trial(Trial(source, "stella", 0), Settings())
    for name in ("BreaksLibraries", "SendsAPickle"):
        assert isolated_trial(Trial(source, f"{HOSTILE}:{name}", 0), Settings()).outcome == "error"
    again = isolated_trial(Trial(source, "stella", 0), Settings())
    times = dict.fromkeys(("frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms", "peak_memory_mb"))
    assert replace(again, **times) == replace(good, **times)
    assert not (tmp_path / "unpickled").exists()


def test_what_is_no_method_is_an_error_of_one_line():
    for name, cause in (("sys:exit", "not a two-view method"), (f"{HOSTILE}:nothing", "cannot be made")):
        with pytest.raises(ConfigError, match=cause) as error:
            check_method(name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[]",
        b"\xff\xfe",
        b'{"request": "TracksRequest", "memory_exhausted": false, "digest": NaN}',
        b'{"request": "TracksRequest", "memory_exhausted": false, "more": 1e999}',
        b'{"request": "TracksRequest", "memory_exhausted": false, "error": 3}',
        b'{"request": "TrialRequest", "memory_exhausted": 1, "row": null}',
        b'{"request": "TrialRequest", "memory_exhausted": true, "row": {}}',
        b"[" * 100_000,
    ],
)
def test_a_line_that_is_no_answer_is_a_value_error(line):
    with pytest.raises(ValueError):
        Answer.parse(line)


def test_an_answer_is_read_as_it_was_written():
    answer = Answer("TracksRequest", "no such file")
    assert Answer.parse(answer.line()) == answer
