"""The time of compilation, and the calls that make up for it: ``python -m tests.benchmarks.quest.first_call``.

Each repetition is two fresh processes that share a new folder for machine code: the first process compiles, the second
finds the machine code on disk. Each process imports quest and estimates the same pair several times, then with
``solver="quest7"``, the search in plain numpy (which uses compiled loops for rotations and parallax too). The
break-even is the number of calls after which the compiled search, first call included, has taken less time than the
search in numpy. The table shows medians over the repetitions.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam_init.output.tables import markdown_table, number
from tests.benchmarks.quest.running import positive, run_on_one_thread, save

__all__ = ["break_even", "main", "measure", "table"]

#: The program of a process: it prints times in milliseconds; the time of a later call is the median of several.
_CHILD = """
import sys, time
start = time.perf_counter()
import numpy
loaded = time.perf_counter()
import quest
times = {"numpy": loaded - start, "quest": time.perf_counter() - loaded}
import json
from tests.benchmarks.quest.scenes import SCENES, draw_scene
matches, outliers, later = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
rng = numpy.random.default_rng(0)
scene = draw_scene(SCENES["general .15"], rng, matches=matches, outlier_share=outliers, noise_px=0.7)
def call(solver):
    start = time.perf_counter()
    assert quest.estimate_relative_pose(scene.bearings1, scene.bearings2, threshold_rad=4e-3, solver=solver)
    return time.perf_counter() - start
times["first"] = call("five")
times["later"] = float(numpy.median([call("five") for _ in range(later)]))
call("quest7")
times["quest7"] = float(numpy.median([call("quest7") for _ in range(later)]))
print(json.dumps({name: 1e3 * seconds for name, seconds in times.items()}))
"""
_LATER_CALLS = 5


def measure(folder: Path, matches: int, outliers: float) -> dict[str, float]:
    """Times of a fresh process in ms, with the machine code in a folder. Keys: numpy, quest, first, later, quest7."""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, str(matches), str(outliers), str(_LATER_CALLS)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    times: dict[str, float] = json.loads(done.stdout)
    return times


def break_even(first: float, later: float, other: float) -> float:
    """The smallest number of calls k with ``first + (k - 1) later <= k other``; infinite if there is none."""
    if first <= other:
        return 1
    return math.ceil((first - later) / (other - later)) if other > later else math.inf


def table(cold: Sequence[dict[str, float]], warm: Sequence[dict[str, float]]) -> str:
    """The medians of processes without and with machine code on disk, in markdown."""
    rows = []
    for title, runs in (("no machine code on disk", cold), ("machine code on disk", warm)):
        middle = {name: float(np.median([run[name] for run in runs])) for name in runs[0]}
        calls = break_even(middle["first"], middle["later"], middle["quest7"])
        times = [number(middle[name], 1) for name in ("numpy", "quest", "first", "later", "quest7")]
        rows.append([title, *times, f"{calls:.0f}"])
    header = ["ms", "import numpy", "import quest", "first call", "later call", "quest7 call", "break-even (calls)"]
    return markdown_table(header, rows) + "\n"


def main(argv: Sequence[str] | None = None) -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.first_call", allow_abbrev=False)
    parser.add_argument("--out", type=Path, help="folder for first_call.md")
    parser.add_argument("--repetitions", type=positive, default=3)
    parser.add_argument("--matches", type=positive, default=500)
    parser.add_argument("--outliers", type=float, default=0.3, help="share of outliers")
    options = parser.parse_args(argv)
    if not 0 <= options.outliers < 1:
        parser.error(f"--outliers is {options.outliers:g}: give a share from 0 to below 1")
    from tqdm import tqdm

    cold: list[dict[str, float]] = []
    warm: list[dict[str, float]] = []
    for _ in tqdm(range(options.repetitions), unit="repetition", disable=None, leave=False):
        with tempfile.TemporaryDirectory() as folder:
            for runs in (cold, warm):
                runs.append(measure(Path(folder), options.matches, options.outliers))
    save(options.out, "first_call.md", table(cold, warm))


if __name__ == "__main__":
    run_on_one_thread()
    main()
