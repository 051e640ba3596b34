"""Measures the time of initialization on one core: ``python -m slam_init.benchmarks.timing``.

The program feeds images of 640x480 pixels to the :class:`~slam_init.initializer.Initializer`. It measures the
wall-clock time of each frame, without reading or rendering the image, and of each stage. All frames before the one at
which the map is accepted are *waiting* frames; they include refused attempts. ``static`` and ``rotation`` never get a
map, so all their frames are waiting frames.

All libraries run on one thread. The numerical libraries read the number of threads when they are imported, so this
module imports them only after it has set that number.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from slam_init.benchmarks.options import positive, show

if TYPE_CHECKING:
    from slam_init.types.stopwatch import StageTimes

__all__ = ["Timing", "machine", "main", "measure", "timing_tables"]

#: Real video of this size, below ``SLAM_INIT_DATA``.
_REAL = "tsukuba/new_tsukuba_150"
_SYNTHETIC = ("synth:room", "synth:static", "synth:rotation")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "TBB_NUM_THREADS")


@dataclass
class Timing:
    """Times of a group of runs, in milliseconds.

    Attributes
    ----------
    name : str
    waiting_ms : list of float
        Time of each frame before the one at which the map was accepted.
    accepted_ms : list of float
        Time of each frame at which a map was accepted.
    stages_ms : dict
        Times of each stage, over all runs.
    """

    name: str
    waiting_ms: list[float] = field(default_factory=list)
    accepted_ms: list[float] = field(default_factory=list)
    stages_ms: dict[str, StageTimes] = field(default_factory=dict)


def measure(name: str, runs: Sequence[tuple[str, int]], max_frames: int | None = None) -> Timing:
    """Measure the times of runs of (source, seed); each run ends when its map is accepted."""
    from slam_init.config import Config
    from slam_init.datasets import open_source
    from slam_init.initializer import Initializer
    from slam_init.types.stopwatch import Stopwatch

    timing, stopwatch = Timing(name), Stopwatch()
    for text, seed in runs:
        source = open_source(text, seed)
        if source.camera is None:
            raise ValueError(f"{text}: no camera; the benchmark runs on calibrated sequences only")
        initializer = Initializer(source.camera, Config(seed=seed, work_per_frame=None))
        initializer.stopwatch = stopwatch  # one stopwatch for all runs, so that percentiles are over all frames
        for frame in source.frames(max_frames=max_frames):
            begin = time.perf_counter()
            status = initializer.process(frame)
            elapsed_ms = 1e3 * (time.perf_counter() - begin)
            if status:
                timing.accepted_ms.append(elapsed_ms)
                break
            timing.waiting_ms.append(elapsed_ms)
    timing.stages_ms = stopwatch.summary()
    return timing


def machine() -> str:
    """Describe the CPU model and the versions, without anything that identifies the machine."""
    import platform

    import cv2
    import numpy as np

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, OpenCV {cv2.__version__}"
    return f"One thread on {model}; {versions}."


def timing_tables(timings: Sequence[Timing]) -> str:
    """Make the tables of the times per frame and per stage, in markdown."""
    import numpy as np

    from slam_init.output.tables import markdown_table, number

    def percentile(samples: list[float], q: float) -> str:
        return number(float(np.percentile(samples, q)) if samples else None, 1)

    header = ["time per frame (ms)", "waiting: median", "p95", "frames", "map accepted: median", "p95", "maps"]
    frames = []
    for timing in timings:
        row = [timing.name]
        for samples in (timing.waiting_ms, timing.accepted_ms):
            row += [percentile(samples, 50), percentile(samples, 95), str(len(samples))]
        frames.append(row)
    stages = list(dict.fromkeys(stage for timing in timings for stage in timing.stages_ms))
    rows = []
    for timing in timings:
        cells = [timing.stages_ms.get(stage) for stage in stages]
        shown = [f"{cell['median']:.1f} / {cell['p95']:.1f} ({cell['calls']:.0f})" if cell else "-" for cell in cells]
        rows.append([timing.name, *shown])
    title = ["time per call (ms): median / p95 (calls)", *stages]
    return markdown_table(header, frames) + "\n\n" + markdown_table(title, rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m slam_init.benchmarks.timing", allow_abbrev=False)
    parser.description = "Time a frame while waiting, and the initialization by stage, on one thread."
    parser.add_argument(
        "--seeds", type=positive, default=3, metavar="N", help="runs of each synthetic scene (default: 3)"
    )
    parser.add_argument("--max-frames", type=positive, metavar="N", help="of a run (default: all)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    arguments = parser.parse_args(argv)
    for variable in _THREADS:
        os.environ[variable] = "1"
    import cv2

    cv2.setNumThreads(1)
    groups = {name: [(name, seed) for seed in range(arguments.seeds)] for name in _SYNTHETIC}
    real = Path(os.environ.get("SLAM_INIT_DATA", "../shared/data")) / _REAL
    if real.is_dir():
        groups[_REAL] = [(str(real), 0)]
    else:
        print(f"no {real}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
    # The first run includes the import of libraries and is not counted.
    measure("warm-up", groups["synth:room"][:1], arguments.max_frames)
    timings = [measure(name, runs, arguments.max_frames) for name, runs in groups.items()]
    show(f"{timing_tables(timings)}\n\n{machine()}\n", arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
