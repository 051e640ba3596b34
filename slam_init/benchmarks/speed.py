"""Measures the time of a frame, of the stages and of the start on one core: ``python -m slam_init.benchmarks.speed``.

Four tables:

* **Frames**: images are given to an :class:`~slam_init.initializer.Initializer` that judges in slices, without reading
  or rendering them. All frames before the one that hands over the map are *waiting* frames. The same sequence is also
  judged in whole frames. The seconds to the map are those of a camera whose frames wait in a queue while one is judged.
* **Stages**: the time of each stage, and of a judgement, which is spread over several frames.
* **Prices**: what the parts of a judgement announce (:class:`slam_init.work.Prices`), and what they take.
* **Robust estimates**: quest and PoseLib on the same matches, one after the other.

Beside each time stands its ratio to a fixed piece of work of the same run: OpenCV's flow of 400 points in an image of
640x480 pixels. The ratios of two machines, or of two states of one machine, can be compared.

All libraries run on one thread. The numerical libraries read the number of threads when they are imported, so this
module imports them only after it has set that number.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from slam_init.benchmarks.options import positive, show

if TYPE_CHECKING:
    from slam_init.initializer import Initializer
    from slam_init.types.frame import Frame, Source
    from slam_init.types.stopwatch import StageTimes

__all__ = ["Frames", "frames_table", "machine", "main", "measure", "prices_table", "stages_table"]

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
#: A camera at 30 Hz delivers a frame in this time.
_FRAME_MS = 33.3
#: Matches, outliers and repetitions of the robust estimates.
_CASES = ((100, 0.2), (1000, 0.2), (1000, 0.5), (1000, 0.7), (5000, 0.5))


@dataclass
class Frames:
    """Times of a sequence, in milliseconds.

    Attributes
    ----------
    name : str
    waiting_ms : list of float
        Time of each frame before the one that hands over the map.
    handover_ms : float or None
        Time of the frame that hands over the map; None without one.
    frames, seconds : int and float, or None
        Frames and seconds until the map, for a camera whose frames wait in a queue; None without a map.
    frames_whole, seconds_whole : int and float, or None
        The same where every frame is judged at once.
    stages_ms : dict
        Times of each stage.
    """

    name: str
    waiting_ms: list[float] = field(default_factory=list)
    handover_ms: float | None = None
    frames: int | None = None
    seconds: float | None = None
    frames_whole: int | None = None
    seconds_whole: float | None = None
    stages_ms: dict[str, StageTimes] = field(default_factory=dict)


def measure(name: str, source: Source, max_frames: int | None = None) -> Frames:
    """Measure a sequence.

    Parameters
    ----------
    name : str
    source : Source
        With a calibration.
    max_frames : int, optional
        Largest number of frames; by default all.

    Returns
    -------
    Frames
    """
    from slam_init.config import REALTIME_WORK, Config
    from slam_init.initializer import Initializer

    if source.camera is None:
        raise ValueError(f"{name}: no camera; the benchmark runs on calibrated sequences only")
    images = list(islice(source.frames(), max_frames))
    arrivals_s = [image.timestamp_s - images[0].timestamp_s for image in images]
    whole, _, times_ms = _processed(Initializer(source.camera, Config(work_per_frame=None)), images)
    measured = Frames(name)
    if whole:
        measured.frames_whole, measured.seconds_whole = len(times_ms), _queued_s(arrivals_s, times_ms)
    sliced = Initializer(source.camera, Config(work_per_frame=REALTIME_WORK))
    mapped, stages_ms, times_ms = _processed(sliced, images)
    if mapped:
        measured.frames, measured.seconds = len(times_ms), _queued_s(arrivals_s, times_ms)
        measured.handover_ms = times_ms.pop()
    measured.waiting_ms, measured.stages_ms = times_ms, stages_ms
    return measured


def _processed(initializer: Initializer, images: Sequence[Frame]) -> tuple[bool, dict[str, StageTimes], list[float]]:
    """Whether an initializer has a map after some images, the times of its stages, and those of the frames (ms)."""
    times_ms: list[float] = []
    for image in images:
        begin = time.perf_counter()
        mapped = bool(initializer.process(image))
        times_ms.append(1e3 * (time.perf_counter() - begin))
        if mapped:
            return True, initializer.stopwatch.summary(), times_ms
    return False, initializer.stopwatch.summary(), times_ms


def _queued_s(arrivals_s: Sequence[float], times_ms: Sequence[float]) -> float:
    """When the last of some frames is processed, each after the one before it and not before it arrives."""
    end_s = 0.0
    for arrival_s, time_ms in zip(arrivals_s, times_ms, strict=False):
        end_s = max(end_s, arrival_s) + 1e-3 * time_ms
    return end_s


def frames_table(measured: Sequence[Frames], flow_ms: float) -> str:
    """The table of the frames.

    Parameters
    ----------
    measured : sequence of Frames
    flow_ms : float
        Time of the fixed piece of work.

    Returns
    -------
    str
        In markdown.
    """
    import numpy as np

    from slam_init.output.tables import markdown_table, number

    header = [
        "ms (ratio to the flow)", "waiting frames", "median", "99th percentile", "largest", "above 33 ms",
        "hand-over", "to the map", "in whole frames",
    ]  # fmt: skip
    rows = []
    for one in measured:
        waiting = np.array(one.waiting_ms or [np.nan])
        times = [float(np.median(waiting)), float(np.percentile(waiting, 99)), float(waiting.max())]
        shown = [f"{number(ms, 1)} ({ms / flow_ms:.1f})" for ms in times]
        handover = "-" if one.handover_ms is None else f"{one.handover_ms:.1f} ({one.handover_ms / flow_ms:.1f})"
        ends = ((one.frames, one.seconds), (one.frames_whole, one.seconds_whole))
        counts = ["-" if count is None else f"{count} frames, {seconds:.2f} s" for count, seconds in ends]
        late = f"{float((waiting > _FRAME_MS).mean()):.1%}"
        rows.append([one.name, str(len(one.waiting_ms)), *shown, late, handover, *counts])
    return markdown_table(header, rows)


def stages_table(measured: Sequence[Frames]) -> str:
    """The table of the stages.

    Parameters
    ----------
    measured : sequence of Frames

    Returns
    -------
    str
        In markdown.
    """
    from slam_init.output.tables import markdown_table

    stages = list(dict.fromkeys(stage for one in measured for stage in one.stages_ms))
    rows = []
    for one in measured:
        cells = [one.stages_ms.get(stage) for stage in stages]
        shown = [f"{cell['median']:.1f} / {cell['p95']:.1f} ({cell['calls']:.0f})" if cell else "-" for cell in cells]
        rows.append([one.name, *shown])
    return markdown_table(["ms a call: median / 95th percentile (calls)", *stages], rows)


def prices_table(sources: Sequence[tuple[str, Source]], max_frames: int | None = None) -> str:
    """What the parts of a judgement announce and what they take, over some sequences.

    Parameters
    ----------
    sources : sequence of (str, Source)
    max_frames : int, optional
        Of each sequence.

    Returns
    -------
    str
        In markdown.
    """
    import numpy as np

    from slam_init import work
    from slam_init.config import Config
    from slam_init.initializer import Initializer
    from slam_init.output.tables import markdown_table, number

    parts: dict[str, list[tuple[float, float]]] = {}
    last: list[tuple[str, float, float]] = []

    def end() -> None:
        if last:
            name, amount, begin = last.pop()
            parts.setdefault(name, []).append((amount, 1e6 * (time.perf_counter() - begin)))

    def spend(amount: float) -> None:
        end()
        caller = sys._getframe(1).f_code
        last.append((f"{Path(caller.co_filename).stem}.{caller.co_name}", amount, time.perf_counter()))

    import_module("slam_init.decision.window_rule")  # and with it all modules that announce work
    real = work.spend
    holders = [module for module in list(sys.modules.values()) if getattr(module, "spend", None) is real]
    try:
        for module in holders:
            vars(module)["spend"] = spend
        for _, source in sources:
            assert source.camera is not None
            # One slice without an end: with as many tracks as in slices.
            initializer = Initializer(source.camera, Config(work_per_frame=math.inf))
            for frame in islice(source.frames(), max_frames):
                done = initializer.process(frame)
                last.clear()
                if done:
                    break
    finally:
        for module in holders:
            vars(module)["spend"] = real
    rows = []
    for name, samples in sorted(parts.items(), key=lambda item: -sum(ms for _, ms in item[1])):
        announced, taken = np.array(samples).T
        figures = [float(np.median(announced)), float(np.median(taken)), float(np.percentile(taken, 95))]
        ratio = float(taken.sum() / announced.sum())
        rows.append([name, str(len(samples)), *(number(one, 0) for one in figures), number(ratio)])
    header = ["part", "calls", "announced (median, us)", "taken: median", "95th percentile", "taken over announced"]
    return markdown_table(header, rows)


def robust_table(repetitions: int) -> str:
    """Times of quest and of PoseLib on the same matches, one after the other.

    Parameters
    ----------
    repetitions : int
        Scenes of each case.

    Returns
    -------
    str
        In markdown; a line that tells what is missing where PoseLib is not installed.
    """
    from importlib.util import find_spec

    if find_spec("poselib") is None:
        return "PoseLib is not installed: pip install 'slam-init[poselib]'"
    import numpy as np

    from quest.benchmarks.robust_methods import METHODS
    from quest.benchmarks.scenes import SCENES, draw_scene
    from slam_init.output.tables import markdown_table, number

    rows = []
    for matches, outliers in _CASES:
        seconds: dict[str, list[float]] = {"quest": [], "PoseLib min 100": []}
        for seed in range(repetitions):
            rng = np.random.default_rng((7, seed))
            scene = draw_scene(SCENES["general .15"], rng, matches=matches, outlier_share=outliers, noise_px=0.7)
            for name, times in seconds.items():
                times.append(METHODS[name][1](scene.bearings1, scene.bearings2, 4e-3, seed).seconds)
        ours, theirs = (1e3 * float(np.median(times)) for times in seconds.values())
        rows.append([f"{matches}, {outliers:.0%}", number(ours, 2), number(theirs, 2), number(ours / theirs)])
    return markdown_table(["matches, outliers", "quest (ms)", "PoseLib, 100 iterations (ms)", "ratio"], rows)


def flow_ms() -> float:
    """The fixed piece of work: the flow of 400 points in an image of 640x480 pixels.

    Returns
    -------
    float
        Median time in milliseconds.
    """
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    large = rng.integers(0, 255, (60, 80), dtype=np.uint8)
    image = cv2.GaussianBlur(cv2.resize(large, (660, 500), interpolation=cv2.INTER_CUBIC), (5, 5), 1.0)
    before, after = (np.ascontiguousarray(image[y : y + 480, x : x + 640]) for x, y in ((0, 0), (4, 3)))
    points = rng.uniform((40, 40), (600, 440), (400, 2)).astype(np.float32)

    def flow() -> None:
        cv2.calcOpticalFlowPyrLK(before, after, points, np.empty_like(points), winSize=(21, 21), maxLevel=3)

    return _median_ms(flow, 21)


def _median_ms(work: Callable[[], None], calls: int) -> float:
    import numpy as np

    times = []
    for _ in range(calls):
        begin = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(times))


def machine() -> str:
    """Describe the CPU model and the versions, without anything that identifies the machine.

    Returns
    -------
    str
        One line.
    """
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


def _sources(names: Sequence[str]) -> list[tuple[str, Source]]:
    from slam_init.datasets import open_source

    folder = Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))
    found: list[tuple[str, Source]] = []
    for name in names:
        if name.startswith("synth:"):
            found.append((name, open_source(name)))
        elif (folder / name).is_dir():
            found.append((name, open_source(str(folder / name))))
        else:
            print(f"no {folder / name}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m slam_init.benchmarks.speed", allow_abbrev=False)
    parser.description = "Time frames, stages, the parts of a judgement and robust estimates, on one thread."
    parser.add_argument("--max-frames", type=positive, default=100, metavar="N", help="of a sequence (default: 100)")
    parser.add_argument("--repetitions", type=positive, default=30, metavar="N", help="of an estimate (default: 30)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    arguments = parser.parse_args(argv)
    for variable in _THREADS:
        os.environ[variable] = "1"
    import cv2
    from tqdm import tqdm

    cv2.setNumThreads(1)
    sources = _sources((*_SYNTHETIC, *_REAL))
    # The first run includes the import of libraries and is not counted.
    measure("warm-up", sources[0][1], arguments.max_frames)
    flows, measured = [flow_ms()], []
    for name, source in tqdm(sources, unit="sequence", disable=None, leave=False):
        measured.append(measure(name, source, arguments.max_frames))
        flows.append(flow_ms())
    typical = sorted(flows)[len(flows) // 2]
    tables = {
        "Frames": frames_table(measured, typical),
        "Stages": stages_table(measured),
        "Prices of the parts of a judgement": prices_table(sources, 30),
        "Robust estimates": robust_table(arguments.repetitions),
    }
    text = "# Speed\n\nBy `python -m slam_init.benchmarks.speed`. "
    text += f"{machine()} The flow of 400 points took {typical:.2f} ms (median of {len(flows)}; "
    text += f"{min(flows):.2f} to {max(flows):.2f}).\n"
    text += "".join(f"\n## {title}\n\n{table}\n" for title, table in tables.items())
    show(text, arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
