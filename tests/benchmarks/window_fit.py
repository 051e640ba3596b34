"""The joint fit of a window: time of a step, coverage of its uncertainty, reliability of the stated risk.

Windows of 2 to 12 views of drawn worlds and of real sequences are fitted. Nothing is decided: each window is logged
with the terms of its risk, with its true errors, and with the squares of these errors in units of the stated
covariance. The tables show what share of the windows with a stated risk was wrong, what a rule on the risk would have
accepted, and how often the errors lie within the 95 % interval::

    python -m tests.benchmarks.window_fit --seeds 100000 100040 --log window_fit.jsonl --out window_fit.md
    python -m tests.benchmarks.window_fit --from-log window_fit.jsonl more.jsonl

The views of a real sequence are those of the tracker of the product, from every eighth frame on. Only sequences with a
sound ground truth are used (:mod:`slam_init.compare.judging`). A folder without sequences is skipped. An empty range of
seeds leaves out the drawn worlds.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import numpy as np

from quest.estimate import NoPose, estimate_relative_pose
from slam_init.compare.judging import Truth, criteria_of
from slam_init.config import TrackingConfig
from slam_init.errors import SlamInitError
from slam_init.frontend.tracks import Tracker, common_tracks
from slam_init.output.tables import markdown_table
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.pose import Pose
from slam_init.window.joint_fit import fit_window
from slam_init.window.linearization import linearize_with_fields
from slam_init.window.live import LiveHypotheses
from slam_init.window.marginal import marginalize_fields
from slam_init.window.risk import WindowRisk, risk_of
from slam_init.window.state import Priors
from slam_init.window.tracks import MAX_TRACKS, gather_tracks
from tests.benchmarks.image_pairs import data_folder
from tests.benchmarks.initialization import find_sequences
from tests.benchmarks.options import positive, show
from tests.benchmarks.window_accuracy import WindowTruth, accuracy_of
from tests.benchmarks.window_log import Accuracy, Window, read_log, write_log
from tests.benchmarks.window_tables import window_report

PLANES = ("wall", "desk", "nadir", "nadir-turn")
TILTED = ("tilted-15", "tilted-30", "tilted-45")
WITHOUT_TRANSLATION = ("rotation", "static")
SCENES = ("room", "corridor", *PLANES, *TILTED, *WITHOUT_TRANSLATION)
BASELINES = (0.03, 0.05, 0.1)
VIEWS = tuple(range(2, 13))
#: Of a calibrated camera.
_PRIORS = Priors()


@dataclass(frozen=True)
class World:
    """A drawn world: noise .3, .7 or 1 px, 5, 15 or 30 % outliers, by the seed."""

    scene: str
    #: Of the whole path over the median depth.
    baseline: float
    seed: int
    #: Standard deviation of the relative error of the stated focal length, which is drawn by the seed.
    focal_sigma: float = 0.0

    def windows(self) -> list[Window]:
        """Judge the windows from the first view on."""
        from slam_init.datasets.points import open_points

        noise_px, outliers = (0.3, 0.7, 1.0)[self.seed % 3], (0.05, 0.15, 0.3)[self.seed // 3 % 3]
        focal_error = self.focal_sigma * float(np.random.default_rng((self.seed, 31)).normal())
        values = f"baseline={self.baseline}&noise_px={noise_px}&outliers={outliers}&focal_error={focal_error}"
        source = open_points(f"points:{self.scene}?{values}", self.seed)
        world = source.sequence
        at_rest = ~(world.is_outlier | world.is_moving)
        poses = {frame: pose.inverse() for frame, pose in enumerate(source.groundtruth.world_from_cam)}
        truth = WindowTruth(poses, np.where(at_rest[:, None], world.points, np.nan), self.scene in WITHOUT_TRANSLATION)
        views = list(source.observations())
        live = LiveHypotheses(source.camera, _PRIORS)
        return [
            Window(
                self.scene,
                self.baseline,
                str(self.seed),
                count,
                *judge_window(live, source.camera, views[:count], truth),
            )
            for count in VIEWS
        ]


@dataclass(frozen=True)
class Clip:
    """The first frames of a real sequence after a start."""

    #: Folder of the sequences.
    data: str
    #: Path of the sequence below this folder.
    name: str
    #: Absolute index of the first frame.
    start: int

    def windows(self) -> list[Window]:
        """Judge the windows from the start on; none where a frame has no true pose."""
        from slam_init.datasets import open_source

        source = open_source(str(Path(self.data) / self.name))
        if source.camera is None or source.groundtruth is None:
            return []
        tracker = Tracker(source.camera, TrackingConfig())
        live = LiveHypotheses(source.camera, _PRIORS)
        poses: dict[int, Pose] = {}
        windows = []
        for frame in source.frames(start=self.start, max_frames=VIEWS[-1]):
            tracker.track(frame)
            pose = source.groundtruth.at(frame.timestamp_s)
            if pose is None:
                break
            poses[frame.index] = pose.inverse()
            if len(poses) >= VIEWS[0]:
                truth = WindowTruth(poses, no_translation=criteria_of(self.name).no_translation)
                # Descriptors may have added tracks to earlier frames.
                views = [tracker.history[index] for index in poses]
                judged = judge_window(live, source.camera, views, truth)
                windows.append(Window(self.name, 0.0, str(self.start), len(views), *judged))
        return windows


Trial: TypeAlias = World | Clip


def judge_window(
    live: LiveHypotheses, camera: Camera, views: Sequence[Observations], truth: WindowTruth
) -> tuple[str, WindowRisk | None, Accuracy, float]:
    """Kind, risk, true errors and milliseconds of a window of consecutive views."""
    reference, current, *further = views[0], views[-1], *views[1:-1]
    i, j = common_tracks(reference, current)
    rays1, rays2 = reference.bearings[i], current.bearings[j]
    pose = estimate_relative_pose(rays1, rays2, threshold_rad=2.0 / camera.focal_px)
    begin = time.perf_counter()
    if not isinstance(pose, NoPose):
        noise_px = max(pose.noise_rad * camera.focal_px, 0.1)
        live.propose(pose, (reference.frame, current.frame), rays1, rays2, noise_px)
    hypotheses = live.fitted([reference, current, *further]) if live else None
    if hypotheses is None:
        return ("none" if isinstance(pose, NoPose) else pose.kind), None, Accuracy(), 0.0
    risk = risk_of(hypotheses)
    milliseconds = 1e3 * (time.perf_counter() - begin)
    kind = "planar" if hypotheses.motions[0].planar else "general"
    return kind, risk, accuracy_of(hypotheses, risk, truth), milliseconds


def worlds_of(seeds: range, baselines: Sequence[float], scenes: Sequence[str], focal_sigma: float = 0.0) -> list[World]:
    """The drawn worlds; a camera that does not translate has one baseline only."""
    return [
        World(scene, baseline, seed, focal_sigma)
        for scene in scenes
        for baseline in (baselines[:1] if scene in WITHOUT_TRANSLATION else baselines)
        for seed in seeds
    ]


def clips_of(data: str | os.PathLike[str], every: int) -> list[Clip]:
    """The clips of the real sequences with a sound truth, one from every k-th frame on.

    A sequence that is shorter than a window has one clip.
    """
    from slam_init.datasets import open_source

    clips = []
    for name in find_sequences(data):
        if criteria_of(name).truth is Truth.SOUND:
            last = max(len(open_source(str(Path(data) / name))) - VIEWS[-1], 0)
            clips += [Clip(os.fspath(data), name, start) for start in range(0, last + 1, every)]
    return clips


def run(trials: Iterable[Trial], jobs: int = 1) -> Iterator[Window]:
    """Judge the windows of all trials, in the order of the trials for any number of processes."""
    if jobs == 1:
        for trial in trials:
            yield from trial.windows()
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as executor:
        for windows in executor.map(_windows_of, trials):
            yield from windows


def _windows_of(trial: Trial) -> list[Window]:
    return trial.windows()


def step_table() -> str:
    """Milliseconds of a Gauss-Newton step at 12 views and as many tracks as a window holds."""
    from slam_init.datasets.points import open_points

    source = open_points("points:room?baseline=0.1", 1)
    views = list(source.observations())
    order = [views[0], views[-1], *views[1:-1]]
    tracks = gather_tracks(source.camera, order, 0.7)
    i, j = common_tracks(order[0], order[1])
    rays1, rays2 = order[0].bearings[i], order[1].bearings[j]
    pose = estimate_relative_pose(rays1, rays2, threshold_rad=2.0 / source.camera.focal_px)
    if isinstance(pose, NoPose):
        raise ValueError("the world of the step table has a pose")
    live = LiveHypotheses(source.camera, _PRIORS)
    live.propose(pose, (order[0].frame, order[1].frame), rays1, rays2, 0.7)
    hypotheses = live.fitted(order)
    if hypotheses is None:
        raise ValueError("the world of the step table has a map")
    best = hypotheses.motions[0]
    part = tracks.of_views(best.rows)
    works: dict[str, Callable[[], object]] = {
        "a Gauss-Newton step": lambda: fit_window(part, best.fit.state, _PRIORS, max_steps=1, tolerance=0.0),
        "the error fields integrated out": lambda: marginalize_fields(linearize_with_fields(part, best.fit, _PRIORS)),
    }
    rows = []
    for name, work in works.items():
        samples = []
        for _ in range(20):
            begin = time.perf_counter()
            work()
            samples.append(1e3 * (time.perf_counter() - begin))
        rows.append([name, f"{np.median(samples):.1f}"])
    return markdown_table([f"at 12 views x {MAX_TRACKS} tracks, with set-up", "ms"], rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Log windows and print the tables; return the exit code."""
    options = _parser().parse_args(argv)
    # For the processes of --jobs; this process limits its threads in each fit.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        if options.from_log:
            windows = [window for path in options.from_log for window in read_log(path)]
            show(window_report(windows, options.max_risk) + "\n", options.out)
            return 0
        found = run(_trials(options), options.jobs)
        windows = _shown(found if options.log is None else write_log(options.log, found))
        show(f"{window_report(windows, options.max_risk)}\n\n{step_table()}\n", options.out)
    except (SlamInitError, OSError) as error:
        sys.stderr.write(f"window_fit: error: {error}\n")
        return 2
    return 0


def _trials(options: argparse.Namespace) -> list[Trial]:
    trials: list[Trial] = list(worlds_of(range(*options.seeds), options.baselines, options.scenes, options.focal_sigma))
    data = data_folder() if options.data is None else options.data
    clips = clips_of(data, options.every)
    if not clips:
        sys.stderr.write(f"window_fit: no real sequences below {data}: set SLAM_INIT_DATA or give --data\n")
    return [*trials, *clips]


def _shown(windows: Iterable[Window]) -> list[Window]:
    """The windows, counted on a terminal as they arrive."""
    from tqdm import tqdm

    return list(tqdm(windows, unit="window", disable=None, leave=False))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.window_fit", allow_abbrev=False)
    parser.add_argument("--seeds", type=int, nargs=2, default=(100_000, 100_020), metavar=("FIRST", "END"))
    parser.add_argument("--baselines", type=float, nargs="+", default=list(BASELINES))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument(
        "--focal-sigma", type=float, default=0.0, metavar="X", help="of the stated focal length of drawn worlds (0)"
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="real sequences (SLAM_INIT_DATA or ../shared/data)")
    parser.add_argument("--every", type=positive, default=8, metavar="N", help="a clip from every N-th frame on (8)")
    parser.add_argument("--max-risk", type=float, default=0.005)
    parser.add_argument("--jobs", type=positive, default=1, metavar="N", help="processes (1)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="write one JSON line a window")
    parser.add_argument(
        "--from-log", type=Path, nargs="+", metavar="FILE", help="print the tables of logs; run nothing"
    )
    parser.add_argument("--out", type=Path, help="file for the tables")
    return parser


if __name__ == "__main__":
    sys.exit(main())
