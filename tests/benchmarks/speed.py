"""Measures the speed of everything on one core: ``python -m tests.benchmarks.speed``.

=====================  ===============================================================================================
table                  what it shows
=====================  ===============================================================================================
frames, stages         images given to an initializer, without reading or rendering them
robust                 quest and PoseLib on the same matches, simulated and real
start                  the first pose of a process, and ``slam-init run``, in new processes
=====================  ===============================================================================================

All times are those of the processor. Beside them stand their ratios to a fixed piece of work of the same run: OpenCV's
flow of 400 points in an image of 640x480 pixels. The ratios of two machines, or of two states of one machine, can be
compared.

* **Frames.** All frames before the one of the final map are *waiting* frames. The seconds to the map are those of a
  camera whose frames wait in a queue while one is evaluated. The stage ``map`` is the evaluation of a window.
* **Robust estimates.** The time of an estimate is the least of three. The estimators take turns between the three, so
  that other load of the machine meets both. Single runs under load misled. A first run also finds the caches of the
  processor filled by other work, such as the matching of images: on real pairs quest then takes 1.4 times as long,
  PoseLib the same time. Both get the same threshold. PoseLib has the setting of its makers: 100 iterations at least.
  The real pairs are those of :mod:`tests.benchmarks.image_pairs`, matched as the pipeline matches photographs.
* **Start.** A new folder for machine code (``NUMBA_CACHE_DIR``) is empty for the first process, which compiles
  (*cold*), and full for the next ones (*warm*).
"""

import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from slam_init.datasets import open_source
from slam_init.initializer import Initializer
from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame, Source
from slam_init.types.stopwatch import StageTimes, Stopwatch
from tests.benchmarks.image_pairs import sequence_pairs
from tests.benchmarks.options import data_folder, program, progress, run_on_one_thread, show
from tests.benchmarks.quest.robust_methods import METHODS, MIN_MATCHES, THRESHOLD_PX, warm_up
from tests.benchmarks.quest.scenes import SCENES, draw_scene
from tests.benchmarks.tables import markdown_table, number

#: Real video, below ``SLAM_INIT_DATA``, and rendered worlds.
_REAL = (
    "tartanair/hospital_clip", "kitti/06_start", "planar/checkerboard_desk", "tsukuba/new_tsukuba_150",
    "tum_rgbd/fr1_rpy_b",
)  # fmt: skip
_SYNTHETIC = ("synth:room", "synth:wall", "synth:nadir", "synth:rotation", "synth:static")
#: Frames of a sequence. A camera at 30 Hz delivers a frame in this time.
_FRAMES, _FRAME_MS = 100, 33.3
#: Matches and outliers of the simulated scenes, scenes of each, and their threshold.
_CASES, _SCENES, _THRESHOLD_RAD = ((100, 0.2), (1000, 0.2), (1000, 0.5), (1000, 0.7), (5000, 0.5)), 100, 4e-3
_OURS, _THEIRS = "quest", "PoseLib min 100"
#: Sequences with a ground truth, frames between the images of a pair, and pairs of each.
_SEQUENCES = ("tartanair/hospital_clip", "kitti/06_start", "tsukuba/new_tsukuba_150")
_STEPS, _PAIRS = (1, 5, 10), 12
#: Estimates of the same matches with the same seed, of which the fastest counts.
_TURNS = 3
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
#: Processes of a kind of start.
_PROCESSES = 3


def flow_ms() -> float:
    """The fixed piece of work: the flow of 400 points in an image of 640x480 pixels; the median of 21 calls."""
    rng = np.random.default_rng(0)
    large = rng.integers(0, 255, (60, 80), dtype=np.uint8)
    image = cv2.GaussianBlur(cv2.resize(large, (660, 500), interpolation=cv2.INTER_CUBIC), (5, 5), 1.0)
    before, after = (np.ascontiguousarray(image[y : y + 480, x : x + 640]) for x, y in ((0, 0), (4, 3)))
    points = rng.uniform((40, 40), (600, 440), (400, 2)).astype(np.float32)
    times_ms = []
    for _ in range(21):
        begin = time.thread_time()
        cv2.calcOpticalFlowPyrLK(before, after, points, np.empty_like(points), winSize=(21, 21), maxLevel=3)
        times_ms.append(1e3 * (time.thread_time() - begin))
    return median(times_ms)


def machine() -> str:
    """Describe the CPU model and the versions, without anything that identifies the machine."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, OpenCV {cv2.__version__}"
    return f"One thread on {model}; {versions}."


@dataclass
class Frames:
    """Times of a sequence, in milliseconds."""

    name: str
    #: Time of each frame before the one of the final map.
    waiting_ms: list[float] = field(default_factory=list)
    #: Time of the frame of the final map; None without one.
    handover_ms: float | None = None
    #: frames, seconds: Frames and seconds until the map, for a camera whose frames wait in a queue; None without a
    #: map.
    frames: int | None = None
    seconds: float | None = None
    #: Times of each stage.
    stages_ms: dict[str, StageTimes] = field(default_factory=dict)


def _measure(name: str, source: Source) -> Frames:
    """Measure a sequence."""
    if source.camera is None:
        raise ValueError(f"{name}: no camera; the benchmark runs on calibrated sequences only")
    images = list(islice(source.frames(), _FRAMES))
    arrivals_s = [image.timestamp_s - images[0].timestamp_s for image in images]
    measured = Frames(name)
    mapped, stages_ms, times_ms = _processed(Initializer(source.camera), images)
    if mapped:
        measured.frames, measured.seconds = len(times_ms), _queued_s(arrivals_s, times_ms)
        measured.handover_ms = times_ms.pop()
    measured.waiting_ms, measured.stages_ms = times_ms, stages_ms
    return measured


def _processed(initializer: Initializer, images: Sequence[Frame]) -> tuple[bool, dict[str, StageTimes], list[float]]:
    """Whether an initializer has a map after some images, the times of its stages, and those of the frames (ms)."""
    times_ms: list[float] = []
    initializer.stopwatch = Stopwatch(time.process_time)
    for image in images:
        begin = time.process_time()
        mapped = bool(initializer.process(image))
        times_ms.append(1e3 * (time.process_time() - begin))
        if mapped:
            return True, initializer.stopwatch.summary(), times_ms
    return False, initializer.stopwatch.summary(), times_ms


def _queued_s(arrivals_s: Sequence[float], times_ms: Sequence[float]) -> float:
    """When the last of some frames is processed, each after the one before it and not before it arrives."""
    end_s = 0.0
    for arrival_s, time_ms in zip(arrivals_s, times_ms, strict=False):
        end_s = max(end_s, arrival_s) + 1e-3 * time_ms
    return end_s


def _frames_table(measured: Sequence[Frames], flow_ms: float) -> str:
    """The table of the frames."""
    header = [
        "ms (ratio to the flow)", "waiting frames", "median", "99th percentile", "largest", "above 33 ms",
        "hand-over", "to the map",
    ]  # fmt: skip
    rows = []
    for one in measured:
        waiting = np.array(one.waiting_ms or [np.nan])
        times = [float(np.median(waiting)), float(np.percentile(waiting, 99)), float(waiting.max())]
        shown = [f"{number(ms, 1)} ({ms / flow_ms:.1f})" for ms in times]
        handover = "-" if one.handover_ms is None else f"{one.handover_ms:.1f} ({one.handover_ms / flow_ms:.1f})"
        end = "-" if one.frames is None else f"{one.frames} frames, {one.seconds:.2f} s"
        late = f"{float((waiting > _FRAME_MS).mean()):.1%}"
        rows.append([one.name, str(len(one.waiting_ms)), *shown, late, handover, end])
    return markdown_table(header, rows)


def _stages_table(measured: Sequence[Frames]) -> str:
    """The table of the stages."""
    stages = list(dict.fromkeys(stage for one in measured for stage in one.stages_ms))
    rows = []
    for one in measured:
        cells = [one.stages_ms.get(stage) for stage in stages]
        shown = [f"{cell['median']:.1f} / {cell['p95']:.1f} ({cell['calls']:.0f})" if cell else "-" for cell in cells]
        rows.append([one.name, *shown])
    return markdown_table(["ms a call: median / 95th percentile (calls)", *stages], rows)


def _sources() -> Iterator[tuple[str, Source]]:
    yield from ((name, open_source(name)) for name in _SYNTHETIC)
    for name in _REAL:
        if (data_folder() / name).is_dir():
            yield name, open_source(str(data_folder() / name))
        else:
            print(f"no {data_folder() / name}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)


def _frames() -> str:
    sources = list(_sources())
    # The first run includes the import of libraries and is not counted.
    _measure("warm-up", sources[0][1])
    flows, measured = [flow_ms()], []
    for name, source in progress(sources, "sequence"):
        measured.append(_measure(name, source))
        flows.append(flow_ms())
    typical = median(flows)
    message = f"The flow of 400 points took {typical:.2f} ms (median of {len(flows)}; {min(flows):.2f} to "
    message += f"{max(flows):.2f}). A frame of a camera at 30 Hz has 33 ms.\n\n"
    return f"{message}{_frames_table(measured, typical)}\n\n### Stages\n\n{_stages_table(measured)}"


def _robust() -> str:
    if _THEIRS not in METHODS:
        return "PoseLib is not installed: pip install '.[poselib]'"
    warm_up([_OURS, _THEIRS])
    cases = {f"{matches}, {outliers:.0%}": _times(_drawn(matches, outliers)) for matches, outliers in _CASES}
    here = [name for name in _SEQUENCES if (data_folder() / name).is_dir()]
    real = {f"{name}, real pairs": _times(_real(data_folder() / name)) for name in here}
    pooled = {name: [one for times in real.values() for one in times[name]] for name in (_OURS, _THEIRS)}
    rows = []
    for case, times in (cases | real | ({"all real pairs": pooled} if real else {})).items():
        if not times[_OURS]:
            rows.append([case, "0", *["-"] * 6])
            continue
        ours, theirs = (np.percentile(times[name], (50, 99)) for name in (_OURS, _THEIRS))
        rows.append([case, str(len(times[_OURS])), *(number(float(one)) for one in (*ours, *theirs, *ours / theirs))])
    header = [
        "matches, outliers", "pairs", "quest: median (ms)", "99th percentile", "PoseLib: median (ms)",
        "99th percentile", "ratio of medians", "of 99th percentiles",
    ]  # fmt: skip
    message = f"CPU time, the fastest of {_TURNS} turns of each estimate, after a warm-up; quest and PoseLib alternate."
    message += " PoseLib runs at least 100 iterations, as its makers advise."
    return f"{markdown_table(header, rows)}\n\n{message}"


def _times(pairs: Iterator[tuple[Floats, Floats, float, int]]) -> dict[str, list[float]]:
    """Least CPU time of each estimator on each pair, in milliseconds."""
    times: dict[str, list[float]] = {_OURS: [], _THEIRS: []}
    for pair in pairs:
        turns = [[METHODS[name](*pair).seconds for name in times] for _ in range(_TURNS)]
        for found, *seconds in zip(times.values(), *turns, strict=True):
            found.append(1e3 * min(seconds))
    return times


def _drawn(matches: int, outliers: float) -> Iterator[tuple[Floats, Floats, float, int]]:
    for seed in range(_SCENES):
        rng = np.random.default_rng((7, seed))
        scene = draw_scene(SCENES["general .15"], rng, matches=matches, outlier_share=outliers, noise_px=0.7)
        yield scene.bearings1, scene.bearings2, _THRESHOLD_RAD, seed


def _real(folder: Path) -> Iterator[tuple[Floats, Floats, float, int]]:
    source = open_source(str(folder))
    for step in _STEPS:
        for pair in sequence_pairs(source, step, _PAIRS) if step < len(source) else ():
            if len(pair.bearings1) >= MIN_MATCHES:
                yield pair.bearings1, pair.bearings2, THRESHOLD_PX / pair.focal_px, 0


def _start() -> str:
    starts: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {"NUMBA_CACHE_DIR": str(Path(folder) / "code")}
        run = ["-m", "slam_init", "run", _WORLD, "--out"]
        starts["import slam_init"] = [_process(["-c", _IMPORT], environment) for _ in range(_PROCESSES)]
        starts["first pose, cold"] = [_process(["-c", _POSE], environment)]
        starts["first pose, warm"] = [_process(["-c", _POSE], environment) for _ in range(_PROCESSES)]
        starts[f"slam-init run {_WORLD}, cold"] = [_process([*run, str(Path(folder) / "cold")], environment)]
        starts[f"slam-init run {_WORLD}, warm"] = [
            _process([*run, str(Path(folder) / str(k))], environment) for k in range(_PROCESSES)
        ]
    flow, rows = flow_ms(), []
    for name, times in starts.items():
        wall_s, cpu_s = (median(some) for some in zip(*times, strict=True))
        rows.append([name, str(len(times)), number(wall_s), number(cpu_s), f"{1e3 * cpu_s / flow:.0f}"])
    message = f"The flow took {flow:.2f} ms of CPU. Each process includes the start of the interpreter.\n\n"
    return message + markdown_table(["process", "processes", "wall (s)", "CPU (s)", "CPU over the flow"], rows)


def _process(arguments: Sequence[str], environment: Mapping[str, str]) -> tuple[float, float]:
    """Seconds from the start of a process to its end, and CPU seconds of the process and of its children."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    wall_s, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments[:3])} failed: {done.stderr.strip()[-500:]}")
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


#: Title and function of each part.
_PARTS: dict[str, tuple[str, Callable[[], str]]] = {
    "frames": ("Frames", _frames),
    "robust": ("Robust estimates", _robust),
    "start": ("Start", _start),
}


def main() -> None:
    """Print the tables."""
    parser = program("speed", __doc__)
    parser.add_argument("--only", nargs="+", choices=list(_PARTS), default=list(_PARTS), help="by default all")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    text = f"# Speed\n\nBy `python -m tests.benchmarks.speed`. {machine()}\n"
    for name in options.only:
        title, measured = _PARTS[name]
        text += f"\n## {title}\n\n{measured()}\n"
    show(text, options.out)


if __name__ == "__main__":
    run_on_one_thread()
    main()
