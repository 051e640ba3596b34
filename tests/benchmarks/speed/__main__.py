"""The program: measures, and prints the tables."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tests.benchmarks.options import choice_list, data_folder, positive, progress, show
from tests.benchmarks.speed.frames import frames_table, measure, stages_table
from tests.benchmarks.speed.timing import cpu_flow_ms, machine

if TYPE_CHECKING:
    from slam_init.types.frame import Source

#: Real video, below ``SLAM_INIT_DATA``.
_REAL = (
    "tartanair/hospital_clip",
    "kitti/06_start",
    "planar/checkerboard_desk",
    "tsukuba/new_tsukuba_150",
    "tum_rgbd/fr1_rpy_b",
)
_SYNTHETIC = ("synth:room", "synth:wall", "synth:nadir", "synth:rotation", "synth:static")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "TBB_NUM_THREADS")


def _sources(names: Sequence[str]) -> list[tuple[str, Source]]:
    from slam_init.datasets import open_source

    folder = data_folder()
    found: list[tuple[str, Source]] = []
    for name in names:
        if name.startswith("synth:"):
            found.append((name, open_source(name)))
        elif (folder / name).is_dir():
            found.append((name, open_source(str(folder / name))))
        else:
            print(f"no {folder / name}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
    return found


def _frames(options: argparse.Namespace) -> str:
    sources = _sources((*_SYNTHETIC, *_REAL))
    # The first run includes the import of libraries and is not counted.
    measure("warm-up", sources[0][1], options.max_frames)
    flows, measured = [cpu_flow_ms()], []
    for name, source in progress(sources, "sequence"):
        measured.append(measure(name, source, options.max_frames))
        flows.append(cpu_flow_ms())
    typical = sorted(flows)[len(flows) // 2]
    message = f"The flow of 400 points took {typical:.2f} ms (median of {len(flows)}; {min(flows):.2f} to "
    message += f"{max(flows):.2f}). A frame of a camera at 30 Hz has 33 ms.\n\n"
    return f"{message}{frames_table(measured, typical)}\n\n### Stages\n\n{stages_table(measured)}"


def _robust(options: argparse.Namespace) -> str:
    from tests.benchmarks.speed.robust import robust_table

    return robust_table(options.repetitions, data_folder())


def _start(options: argparse.Namespace) -> str:
    from tests.benchmarks.speed.start import measure_start, start_table

    flow = cpu_flow_ms()
    message = f"The flow took {flow:.2f} ms of CPU. Each process includes the start of the interpreter.\n\n"
    return message + start_table(measure_start(options.processes), flow)


#: Title and function of each part.
_PARTS: dict[str, tuple[str, Callable[[argparse.Namespace], str]]] = {
    "frames": ("Frames", _frames),
    "robust": ("Robust estimates", _robust),
    "start": ("Start", _start),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.speed", allow_abbrev=False)
    parser.description = "Time frames, robust estimates, the start, and the largest stages, on one thread."
    parser.add_argument(
        "--only", type=choice_list(list(_PARTS)), default=list(_PARTS), metavar="A,B", help=f"of {', '.join(_PARTS)}"
    )
    parser.add_argument("--max-frames", type=positive, default=100, metavar="N", help="of a sequence (default: 100)")
    parser.add_argument("--repetitions", type=positive, default=100, metavar="N", help="of an estimate (default: 100)")
    parser.add_argument("--processes", type=positive, default=3, metavar="N", help="of a kind of start (default: 3)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    options = parser.parse_args(argv)
    for variable in _THREADS:
        os.environ[variable] = "1"
    import cv2

    cv2.setNumThreads(1)
    text = f"# Speed\n\nBy `python -m tests.benchmarks.speed`. {machine()}\n"
    for name in options.only:
        title, measured = _PARTS[name]
        text += f"\n## {title}\n\n{measured(options)}\n"
    show(text, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
