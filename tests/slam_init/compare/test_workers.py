"""A method that fails spoils only its own trial; no process outlives a comparison; a cluster gives the same rows."""

import os
import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from comparisons import METHODS, SOURCES, rows_of
from process_tree import MARK, left_over, new_mark, processes_with

from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Settings, Trial
from slam_init.compare.workers import run_on_cluster, run_trials
from slam_init.errors import ConfigError, SlamInitError

pytestmark = pytest.mark.process

PARENT = f"""
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Settings, Trial
from slam_init.compare.workers import run_trials
source = describe_sources({SOURCES[:1]!r})[0]
trials = [Trial(source, method, 0) for method in ("stella", "failing_methods:Loops")]
for row in run_trials(trials, Settings(), 1):
    print("ready", flush=True)
"""


def test_each_kind_of_failure_is_an_error_of_its_own_trial():
    source = describe_sources(SOURCES[:1])[0]
    causes = {
        "stella": None,
        "failing_methods:Raises": "RuntimeError: no such thing as a pose at failing_methods.py:14",
        "failing_methods:Exits": "SystemExit: 3 at failing_methods.py:19",
        "failing_methods:Aborts": "the process died (SIGABRT)",
        "failing_methods:EatsMemory": "more than 400 MB of memory",
    }
    trials = [Trial(source, method, 0) for method in causes]
    rows = {row.method: row for row in run_trials(trials, Settings(memory_limit_mb=400), 2)}
    assert rows["stella"].outcome == "correct"
    assert {method: rows[method].reason for method in causes} == causes
    assert {row.outcome for row in rows.values() if row.method != "stella"} == {"error"}


def test_a_trial_that_does_not_end_is_stopped_at_its_limit():
    source = describe_sources(SOURCES[:1])[0]
    (row,) = run_trials([Trial(source, "failing_methods:Loops", 0)], Settings(time_limit_s=1.0), 1)
    assert (row.outcome, row.reason) == ("error", "no answer within 1 s")


@pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc")
def test_no_process_outlives_a_parent_that_is_killed():
    mark = new_mark()
    environment = os.environ | {MARK: mark, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    parent = subprocess.Popen([sys.executable, "-c", PARENT], env=environment, stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"ready\n"
    assert len(processes_with(mark)) > 1
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    # The kernel ends the processes; the output is theirs as well, so it is closed when all have ended.
    assert parent.stdout.read() == b""
    parent.stdout.close()
    assert left_over(mark) == []


def test_a_cluster_gives_the_same_results(plan, finished, tmp_path):
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    options = {"threads_per_worker": 1, "processes": False, "dashboard_address": None, "protocol": "tcp"}
    with distributed.LocalCluster(n_workers=1, **options) as cluster:
        compare(replace(plan, methods=METHODS[:1]), tmp_path, backend=f"dask:{cluster.scheduler_address}")
    assert rows_of(tmp_path) == [row for row in rows_of(finished[0]) if row["method"] == METHODS[0]]


def test_what_is_wrong_with_a_cluster_is_one_line(plan, tmp_path):
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    for address in ("127.0.0.1:1", "nope"):
        with pytest.raises(SlamInitError, match=r"the Dask cluster at .* failed: .*") as error:
            list(run_on_cluster(address, list(plan.trials()), plan.settings))
        assert "\n" not in str(error.value)
    for backend in ("spark", "loky", "sequential"):
        with pytest.raises(ConfigError, match="use dask:ADDRESS, or --jobs"):
            compare(plan, tmp_path, backend=backend)
