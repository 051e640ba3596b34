"""A comparison on a hundred simulated workers: the same results as on one, few open trials, and it resumes."""

import json

import pytest

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from tests.benchmarks.simulated_cluster import TRACKING_S, SimulatedCluster, simulated_sources

METHODS = ("quest", "stella")
PLAN = Plan(simulated_sources(30), METHODS, every=40)
TRIALS = sum(1 for _ in PLAN.trials())
FILES = ("results.csv", "summary.json", "report.html")


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    out = tmp_path_factory.mktemp("one")
    compare(PLAN, out, backend=SimulatedCluster(1))
    return out


@pytest.mark.parametrize(("workers", "largest_batch"), [(2, 1), (100, 1), (3, 50)])
def test_the_results_do_not_depend_on_the_number_of_workers(workers, largest_batch, expected, tmp_path):
    compare(PLAN, tmp_path, backend=SimulatedCluster(workers, largest_batch))
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (expected / name).read_bytes()


@pytest.mark.parametrize("workers", [1, 10, 100])
def test_two_tasks_of_a_worker_are_open_at_most(workers, tmp_path):
    cluster = SimulatedCluster(workers)
    compare(PLAN, tmp_path, backend=cluster)
    assert cluster.virtual.largest_open == min(2 * workers, TRIALS)


class Killed(SimulatedCluster):
    """A cluster that is lost after some answers."""

    def __init__(self, workers, answers):
        super().__init__(workers)
        self.answers = answers

    def _next(self, ended):
        self.answers -= 1
        if self.answers < 0:
            raise KeyboardInterrupt
        return super()._next(ended)


def test_each_answer_is_on_disk_at_once_and_no_trial_runs_twice(expected, tmp_path):
    answers = 57
    with pytest.raises(KeyboardInterrupt):
        compare(PLAN, tmp_path, backend=Killed(10, answers))
    stored = (tmp_path / "trials.jsonl").read_text().splitlines()[1:]
    assert len(stored) == answers - len(PLAN.sources)  # the tracks of each source are an answer as well
    assert all(json.loads(line) for line in stored)
    compare(PLAN, tmp_path, backend=SimulatedCluster(100))
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()[1:]
    assert len(lines) == TRIALS
    assert lines[: len(stored)] == stored
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (expected / name).read_bytes()


def test_a_worker_makes_the_tracks_of_a_source_once_for_a_batch():
    plan = Plan(simulated_sources(20), METHODS, every=2)
    trackings = []
    for largest in (1, 50):
        batches = list(plan.batches(lambda _: True, largest))
        cluster = SimulatedCluster(20, largest)
        assert len(list(cluster.run(len, batches))) == len(batches)
        trackings.append(cluster.virtual.tracking_s / TRACKING_S)
        assert trackings[-1] <= len(batches)
    assert trackings[1] < trackings[0] / 4
