"""The start of a process: ``python -m tests.benchmarks.start``.

Each row is a program in a fresh process, timed by itself without the start of the interpreter: CPU time of all its
threads, and time on the clock. "Cold" programs find no machine code of the compiled loops on disk, "warm" ones find all
of it. Times on the clock count only on an idle machine: the share of it for which the program had no processor tells
whether it was one. Beside each CPU time stands its ratio to a fixed piece of work in the same repetition, the flow of
400 points.

The last rows are four first poses that start at once on an empty folder, and a first pose of an installation that
contains its machine code, for a user without a folder to write.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.options import positive, show
from tests.benchmarks.speed import flow_ms, machine

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "TBB_NUM_THREADS")
#: Around each program. A program may set ``before`` anew.
_HEAD = """
import json, time
clocks = lambda: (time.process_time(), time.perf_counter())
before = clocks()
"""
_TAIL = """
print(json.dumps([b - a for a, b in zip(before, clocks())]))
"""
_POSE = """
import numpy, quest
from tests.benchmarks.quest.scenes import SCENES, draw_scene
scene = draw_scene(SCENES["general .15"], numpy.random.default_rng(0), matches=500, outlier_share=0.3, noise_px=0.7)
before = clocks()
assert quest.estimate_relative_pose(scene.bearings1, scene.bearings2, threshold_rad=4e-3)
"""
_LOAD = "from slam_init.initializer import load_all; before = clocks(); load_all()"
_RUN = """
import tempfile
from slam_init.cli.main import main
with tempfile.TemporaryDirectory() as folder:
    assert main(["run", "--quiet", "--out", folder + "/out", *{options}]) == 0
"""
_IMPORTS = {"import slam_init": "import slam_init", "import quest": "import quest"}
_COMPILED = {
    "first pose of a process": _POSE,
    "what a judgement needs (load_all)": _LOAD,
    "slam-init run": _RUN.format(options=[]),
    "slam-init run --no-overview": _RUN.format(options=["--no-overview"]),
}
_AT_ONCE = 4


@dataclass(frozen=True)
class Started:
    """Times of a process."""

    #: cpu_s, clock_s: CPU time of all threads, and time on the clock.
    cpu_s: float
    clock_s: float
    #: Time of the fixed piece of work.
    flow_ms: float


def started(program: str, machine_code: Path | None, reference_ms: float, **environment: str) -> Started:
    """Run a program in a fresh process."""
    return _times(_process(program, machine_code, **environment), reference_ms)


def _process(program: str, machine_code: Path | None, **environment: str) -> subprocess.Popen[str]:
    import quest

    # The packages of this process, and not those of the folder in which it was started.
    here = str(Path(quest.__file__).parents[1])
    variables = os.environ | dict.fromkeys(_THREADS, "1") | {"PYTHONPATH": here} | environment
    variables.pop("NUMBA_CACHE_DIR", None)
    if machine_code is not None:
        variables["NUMBA_CACHE_DIR"] = str(machine_code)
    command = [sys.executable, "-c", _HEAD + program + _TAIL]
    return subprocess.Popen(command, env=variables, cwd=tempfile.gettempdir(), stdout=subprocess.PIPE, text=True)


def _times(process: subprocess.Popen[str], reference_ms: float) -> Started:
    printed, _ = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"a measured program ended with code {process.returncode}")
    cpu_s, clock_s = json.loads(printed.splitlines()[-1])
    return Started(cpu_s, clock_s, reference_ms)


def _repetition(measured: dict[str, list[Started]]) -> None:
    """Add one process to each row, four to that of the processes at once."""
    reference_ms = flow_ms()

    def add(row: str, *times: Started) -> None:
        measured.setdefault(row, []).extend(times)

    for title, program in _IMPORTS.items():
        add(title, started(program, None, reference_ms))
    for title, program in _COMPILED.items():
        with tempfile.TemporaryDirectory() as folder:
            for state in ("cold", "warm"):
                add(f"{title}, {state}", started(program, Path(folder), reference_ms))
    with tempfile.TemporaryDirectory() as folder:
        processes = [_process(_POSE, Path(folder)) for _ in range(_AT_ONCE)]
        add(f"{_AT_ONCE} first poses at once, cold", *(_times(process, reference_ms) for process in processes))
    with tempfile.TemporaryDirectory() as folder:
        add("first pose of an installation with machine code", _installed(Path(folder), reference_ms))


def _installed(folder: Path, reference_ms: float) -> Started:
    """A first pose of a copy of the package that has machine code, by a user who has no folder to write."""
    import quest

    shutil.copytree(Path(quest.__file__).parent, folder / "quest", ignore=shutil.ignore_patterns("*.code"))
    nowhere = folder / "no folder"
    nowhere.touch()
    users = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), str(nowhere / "home"))
    for _ in range(2):  # the installation, then its user
        times = started(_POSE, None, reference_ms, PYTHONPATH=str(folder), **users)
    return times


def table(measured: Mapping[str, Sequence[Started]]) -> str:
    """The medians of each row."""
    import numpy as np

    from slam_init.output.tables import markdown_table, number

    rows = []
    for title, processes in measured.items():
        cpu_s = float(np.median([one.cpu_s for one in processes]))
        clock_s = float(np.median([one.clock_s for one in processes]))
        ratio = float(np.median([1e3 * one.cpu_s / one.flow_ms for one in processes]))
        waited = float(np.median([max(1 - one.cpu_s / one.clock_s, 0.0) for one in processes]))
        rows.append([title, number(cpu_s, 3), number(clock_s, 3), f"{waited:.0%}", number(ratio, 0)])
    return markdown_table(["process", "CPU (s)", "clock (s)", "without processor", "CPU over the flow"], rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.start", allow_abbrev=False)
    parser.description = "Time imports, first poses and runs of fresh processes."
    parser.add_argument("--repetitions", type=positive, default=3, metavar="N", help="of each process (default: 3)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    arguments = parser.parse_args(argv)
    import cv2
    from tqdm import tqdm

    cv2.setNumThreads(1)
    measured: dict[str, list[Started]] = {}
    for _ in tqdm(range(arguments.repetitions), unit="repetition", disable=None, leave=False):
        _repetition(measured)
    show(f"# Start of a process\n\n{machine()}\n\n{table(measured)}\n", arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
