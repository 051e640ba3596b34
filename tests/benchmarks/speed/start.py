"""The start of a process: the first pose without and with machine code on disk, and ``slam-init run`` on a world.

Each program runs in a new process. A new folder for machine code (``NUMBA_CACHE_DIR``) is empty for the first process,
which compiles (*cold*), and full for the next ones (*warm*).
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

_IMPORT = "import slam_init"
#: The first pose: one estimate of a simulated scene with 500 matches. Loading numpy and drawing the scene are part of
#: it.
_POSE = """
import numpy, quest
rng = numpy.random.default_rng(0)
X = rng.uniform((-1, -1, 2), (1, 1, 4), (500, 3))
rays = [Y / numpy.linalg.norm(Y, axis=1, keepdims=True) for Y in (X, X + (0.2, 0.0, 0.0))]
assert quest.estimate_relative_pose(*rays, threshold_rad=4e-3)
"""
_WORLD = "synth:room"


@dataclass(frozen=True)
class Start:
    """Times of a process."""

    #: From its start to its end.
    wall_s: float
    #: CPU time of the process and of its children.
    cpu_s: float


def measure_start(repetitions: int) -> dict[str, list[Start]]:
    """Measure the starts."""
    found: dict[str, list[Start]] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {"NUMBA_CACHE_DIR": str(Path(folder) / "code")}
        run = ["-m", "slam_init", "run", _WORLD, "--out"]
        found["import slam_init"] = [_process(["-c", _IMPORT], environment) for _ in range(repetitions)]
        found["first pose, cold"] = [_process(["-c", _POSE], environment)]
        found["first pose, warm"] = [_process(["-c", _POSE], environment) for _ in range(repetitions)]
        found[f"slam-init run {_WORLD}, cold"] = [_process([*run, str(Path(folder) / "cold")], environment)]
        found[f"slam-init run {_WORLD}, warm"] = [
            _process([*run, str(Path(folder) / str(k))], environment) for k in range(repetitions)
        ]
    return found


def _process(arguments: Sequence[str], environment: Mapping[str, str]) -> Start:
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    wall_s, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments[:3])} failed: {done.stderr.strip()[-500:]}")
    return Start(wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def start_table(starts: Mapping[str, Sequence[Start]], flow_ms: float) -> str:
    """The table of the starts."""
    from statistics import median

    from tests.benchmarks.tables import markdown_table, number

    rows = []
    for name, processes in starts.items():
        wall_s, cpu_s = median(one.wall_s for one in processes), median(one.cpu_s for one in processes)
        rows.append([name, str(len(processes)), number(wall_s), number(cpu_s), f"{1e3 * cpu_s / flow_ms:.0f}"])
    return markdown_table(["process", "processes", "wall (s)", "CPU (s)", "CPU over the flow"], rows)
