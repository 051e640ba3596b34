"""Scale: a long wait of one initializer, and comparisons of many trials on many workers.

* **Waiting**: tracks of a camera that stands and of one that only turns are given for 10,000 frames. Time and memory of
  a frame must not grow, so each row tells the first and the last tenth.
* **Comparison**: the loop, journal and tables of ``slam-init compare`` with workers in virtual time
  (:mod:`tests.benchmarks.simulated_cluster`), in the CPU time of the scheduler for a trial.
* **Processes**: a comparison of two quick methods on worlds of points with one and two processes on this machine.
"""

from __future__ import annotations

import tempfile
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, cycle, islice
from pathlib import Path

import numpy as np

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.config import REALTIME_WORK, Config
from slam_init.datasets.points import open_points
from slam_init.initializer import Initializer
from slam_init.output.tables import markdown_table, number
from tests.benchmarks.simulated_cluster import SimulatedCluster, simulated_sources

#: The worlds of the wait. The tracks of some frames are shown forth and back.
_WORLDS = ("points:static", "points:rotation")
_METHODS = ("quest", "stella")
#: Sources, step of the start frames, workers, largest batch: the number of trials grows, then that of the workers.
_SIMULATED = (
    (100, 40, 100, 1),
    (1000, 40, 100, 1),
    (1000, 20, 100, 1),
    (1000, 40, 1, 1),
    (1000, 40, 1000, 1),
    (1000, 20, 100, 50),
)


@dataclass(frozen=True)
class Waiting:
    """The first and the last tenth of a wait."""

    name: str
    frames: int
    #: median_ms, p99_ms: (float, float) CPU time of a frame.
    median_ms: tuple[float, float]
    p99_ms: tuple[float, float]
    #: (float, float) Resident memory at the end of each of them.
    memory_mb: tuple[float, float]


def measure_waiting(frames: int) -> list[Waiting]:
    """Let an initializer wait for some frames before each world."""
    return [_waiting(name, frames) for name in _WORLDS]


def _waiting(name: str, frames: int) -> Waiting:
    source = open_points(name, 0)
    shown = list(source.observations(0))
    initializer = Initializer(source.camera, Config(work_per_frame=REALTIME_WORK))
    tenth, times_ms, memory_mb = max(1, frames // 10), [], []
    for k, observed in enumerate(islice(cycle(chain(shown, shown[::-1])), frames)):
        observed = replace(observed, frame=k, timestamp_s=k / 30)
        begin = time.thread_time()
        if initializer.process_tracks(observed):
            raise ValueError(f"{name}: the camera does not translate, and there is a map")
        times_ms.append(1e3 * (time.thread_time() - begin))
        if k + 1 in (tenth, frames):
            memory_mb.append(_memory_mb())
    of_tenths = [np.percentile(one, (50, 99)) for one in (times_ms[:tenth], times_ms[-tenth:])]
    (median1, p99_1), (median2, p99_2) = (map(float, one) for one in of_tenths)
    return Waiting(name, frames, (median1, median2), (p99_1, p99_2), (memory_mb[0], memory_mb[-1]))


def _memory_mb() -> float:
    from tests.benchmarks.soak import memory_mb

    return memory_mb()


def waiting_table(measured: Sequence[Waiting], flow_ms: float) -> str:
    """The table of the waits; ``flow_ms`` is the CPU time of the fixed piece of work."""
    rows = []
    for one in measured:
        times = [f"{first:.2f} / {last:.2f} ({last / flow_ms:.2f})" for first, last in (one.median_ms, one.p99_ms)]
        memory = f"{one.memory_mb[0]:.1f} / {one.memory_mb[1]:.1f}"
        rows.append([one.name, str(one.frames), *times, number(one.median_ms[1] / one.median_ms[0]), memory])
    header = [
        "first / last tenth", "frames", "median CPU ms (last over the flow)", "99th percentile",
        "last median over first", "memory (MB)",
    ]  # fmt: skip
    return markdown_table(header, rows)


@dataclass(frozen=True)
class Overhead:
    """A comparison on simulated workers."""

    sources: int
    trials: int
    workers: int
    largest_batch: int
    #: CPU time of the scheduler for a trial, from the first submission to the last answer, with the journal.
    loop_ms: float
    #: The same for all before and after: plan, result files, report.
    tables_ms: float
    #: Largest memory that Python held at a time for the comparison; None where it was not measured.
    memory_mb: float | None
    #: Largest number of trials that were submitted and had not ended.
    open_trials: int
    #: Share of the virtual time in which a worker works, in the mean.
    busy: float
    #: Share of the work that goes into tracks, which each worker makes for each source that it gets.
    tracking: float


def measure_simulated() -> list[Overhead]:
    """Measure comparisons on simulated workers; the memory of each number of trials once, since tracing it is slow."""
    traced = {(sources, every): workers for sources, every, workers, _ in reversed(_SIMULATED)}
    return [
        simulate(sources, every, workers, batch, trace=batch == 1 and traced[sources, every] == workers)
        for sources, every, workers, batch in _SIMULATED
    ]


def simulate(sources: int, every: int, workers: int, largest_batch: int, *, trace: bool = True) -> Overhead:
    """Run a comparison on simulated workers: in CPU time, and again with its memory traced."""
    plan = Plan(simulated_sources(sources), _METHODS, every=every)
    cluster = SimulatedCluster(workers, largest_batch)
    with tempfile.TemporaryDirectory() as out:
        begin = time.process_time()
        trials = compare(plan, out, backend=cluster).trials
        total_s = time.process_time() - begin
    memory_mb = _traced_mb(plan, SimulatedCluster(workers, largest_batch)) if trace else None
    virtual = cluster.virtual
    loop_s = virtual.last_cpu_s - virtual.first_cpu_s - virtual.drawing_cpu_s
    return Overhead(
        sources,
        trials,
        workers,
        largest_batch,
        1e3 * loop_s / trials,
        1e3 * (total_s - loop_s - virtual.drawing_cpu_s) / trials,
        memory_mb,
        virtual.largest_open,
        virtual.busy_s / (workers * virtual.clock_s),
        virtual.tracking_s / virtual.busy_s,
    )


def _traced_mb(plan: Plan, cluster: SimulatedCluster) -> float:
    with tempfile.TemporaryDirectory() as out:
        tracemalloc.start()
        try:
            compare(plan, out, backend=cluster)
            return tracemalloc.get_traced_memory()[1] / 2**20
        finally:
            tracemalloc.stop()


def overhead_table(measured: Sequence[Overhead]) -> str:
    """The table of the simulated comparisons."""
    header = [
        "sources", "trials", "workers", "trials in a task, at most", "loop (CPU ms a trial)", "tables (CPU ms a trial)",
        "memory (MB)", "open trials, at most", "workers busy", "of this, making tracks",
    ]  # fmt: skip
    rows = [
        [
            str(one.sources), str(one.trials), str(one.workers), str(one.largest_batch), number(one.loop_ms, 3),
            number(one.tables_ms, 3), number(one.memory_mb, 1), str(one.open_trials), f"{one.busy:.0%}",
            f"{one.tracking:.0%}",
        ]
        for one in measured
    ]  # fmt: skip
    return markdown_table(header, rows)


def measure_processes(sources: int) -> list[tuple[int, int, float, float]]:
    """Compare two quick methods with one and two processes: processes, trials, wall s, CPU ms of the scheduler."""
    texts = [f"points:room?views=30&seed={k}" for k in range(sources)]
    plan = Plan(tuple(describe_sources(texts)), ("stella", "orb-slam3"), every=5)
    found = []
    for jobs in (1, 2):
        with tempfile.TemporaryDirectory() as out:
            begin, cpu = time.perf_counter(), time.process_time()
            trials = compare(plan, Path(out) / "out", backend="loky", jobs=jobs).trials
            cpu_s, wall_s = time.process_time() - cpu, time.perf_counter() - begin
        found.append((jobs, trials, wall_s, 1e3 * cpu_s / trials))
    return found


def processes_table(measured: Sequence[tuple[int, int, float, float]]) -> str:
    """The table of :func:`measure_processes`."""
    header = ["processes", "trials", "wall (s)", "wall ms a trial and process", "scheduler (CPU ms a trial)"]
    rows = [
        [str(jobs), str(trials), number(wall_s, 1), number(1e3 * wall_s * jobs / trials, 0), number(cpu_ms, 2)]
        for jobs, trials, wall_s, cpu_ms in measured
    ]
    return markdown_table(header, rows)
