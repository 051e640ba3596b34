"""How long it takes on one core: ``python -m slam_init.benchmarks.timing``.

Feeds images of 640x480 to the :class:`~slam_init.initializer.Initializer` and takes the wall-clock time of each frame,
reading or rendering of the image excluded, and of each stage. A frame is *waiting* until the one at which the map is
accepted; attempts that are refused on the way are part of waiting. ``static`` and ``rotation`` never end, so that all
of their frames wait.

One thread: OpenCV is told so, and the numerical libraries are before they are loaded, which is why this module loads
nothing heavy at its top.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from slam_init.benchmarks.options import positive, show

__all__ = ["Timing", "machine", "main", "measure"]

#: Real video of this size, below ``SLAM_INIT_DATA``.
_REAL = "tsukuba/new_tsukuba_150"
_SYNTHETIC = ("synth:room", "synth:static", "synth:rotation")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "TBB_NUM_THREADS")


@dataclass
class Timing:
    """Times of a group of runs in milliseconds.

    Attributes
    ----------
    name : str
    waiting_ms : list of float
        Of each frame before the accepted one.
    accepted_ms : list of float
        Of each frame at which a map was accepted.
    stages_ms : dict
        Stage -> {"median", "p95", "total", "calls"}, over all runs.
    """

    name: str
    waiting_ms: list[float] = field(default_factory=list)
    accepted_ms: list[float] = field(default_factory=list)
    stages_ms: dict[str, dict[str, float]] = field(default_factory=dict)


def measure(name: str, runs: Sequence[tuple[str, int]], max_frames: int | None = None) -> Timing:
    """Time the runs of (source, seed), each until its map is accepted."""
    from slam_init.config import Config
    from slam_init.datasets import open_source
    from slam_init.initializer import Initializer
    from slam_init.types.stopwatch import Stopwatch

    timing, stopwatch = Timing(name), Stopwatch()
    for text, seed in runs:
        source = open_source(text, seed)
        if source.camera is None:
            raise ValueError(f"{text}: no camera; the benchmark runs on calibrated sequences only")
        initializer = Initializer(source.camera, Config(seed=seed))
        initializer.stopwatch = stopwatch  # one for all runs: percentiles over all of their frames
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
    """CPU model and versions; nothing that tells one machine of that kind from another."""
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


def _tables(timings: Sequence[Timing]) -> str:
    import numpy as np

    from slam_init.output.tables import markdown_table, number

    def percentile(samples: list[float], q: float) -> str:
        return number(float(np.percentile(samples, q)) if samples else None, 1)

    header = ["a frame (ms)", "waiting: median", "p95", "frames", "map accepted: median", "p95", "maps"]
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
    title = ["a call (ms): median / p95 (calls)", *stages]
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
    # The first run pays for the loading of libraries and is not counted.
    measure("warm-up", groups["synth:room"][:1], arguments.max_frames)
    timings = [measure(name, runs, arguments.max_frames) for name, runs in groups.items()]
    show(f"{_tables(timings)}\n\n{machine()}\n", arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
