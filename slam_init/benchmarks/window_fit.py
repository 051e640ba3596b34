"""The joint fit of a window: time of a step, coverage of its uncertainty, reliability of the stated risk.

For drawn worlds, windows of 2 to 12 views are fitted. Nothing is
decided: each window is logged with the terms of its risk and with its true error. The tables show, for each scene, how
often the error of the direction lies within 95 % of its distribution, what share of the windows with a stated risk was
wrong, and what a rule on the risk would have accepted::

    python -m slam_init.benchmarks.window_fit --seeds 100000 100040 --out window_fit.md
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quest.estimate import NoPose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle
from slam_init.benchmarks.options import show
from slam_init.decision.window_rule import WINDOW_PRIORS
from slam_init.frontend.tracks import common_tracks
from slam_init.output.tables import markdown_table
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.pose import Pose
from slam_init.window.hypotheses import FittedMotion
from slam_init.window.joint_fit import fit_window
from slam_init.window.linearization import linearize_with_fields
from slam_init.window.live import LiveHypotheses
from slam_init.window.marginal import marginalize_fields
from slam_init.window.risk import WindowRisk, risk_of
from slam_init.window.tracks import MAX_TRACKS, gather_tracks

PLANES = ("wall", "desk", "nadir", "nadir-turn")
TILTED = ("tilted-15", "tilted-30", "tilted-45")
SCENES = ("room", "corridor", *PLANES, *TILTED, "rotation", "static")
BASELINES = (0.03, 0.05, 0.1)
VIEWS = tuple(range(2, 13))
#: What counts as wrong, in degrees.
ROTATION_DEG, DIRECTION_DEG = 5.0, 15.0
#: Bins of the stated risk.
RISK_BINS = ((0.0, 0.001), (0.001, 0.005), (0.005, 0.05), (0.05, 0.5), (0.5, 1.0))


@dataclass(frozen=True)
class Window:
    """One window, as it would have been judged.

    Attributes
    ----------
    scene : str
    baseline : float
        Over the median depth; 0 for real sequences.
    start : str
        Name of the trial: the seed of a world, or the first frame.
    views : int
        Number of views of the window.
    kind : str
        Kind of the pair's pose; ``none`` where there is none.
    risk : WindowRisk or None
        None where no motion was proposed.
    rotation_deg, direction_deg : float
        True errors of the best hypothesis; NaN without one.
    milliseconds : float
        Of all fits and the risk, without the pair's pose.
    """

    scene: str
    baseline: float
    start: str
    views: int
    kind: str
    risk: WindowRisk | None
    rotation_deg: float = math.nan
    direction_deg: float = math.nan
    milliseconds: float = 0.0

    @property
    def wrong(self) -> bool:
        """Whether a map of the best hypothesis would be wrong."""
        return not (self.rotation_deg <= ROTATION_DEG and self.direction_deg <= DIRECTION_DEG)


def judge_window(
    live: LiveHypotheses, camera: Camera, views: Sequence[Observations], cam_from_world: Sequence[Pose]
) -> tuple[str, WindowRisk | None, float, float, float]:
    """Kind, risk, true errors (rotation and direction, degrees) and milliseconds of a window of consecutive views."""
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
        return ("none" if isinstance(pose, NoPose) else pose.kind), None, math.nan, math.nan, 0.0
    risk = risk_of(hypotheses)
    milliseconds = 1e3 * (time.perf_counter() - begin)
    true = {view.frame: one for view, one in zip(views, cam_from_world, strict=True)}
    rotation, direction = _errors(hypotheses.motions[0], [true[frame] for frame in hypotheses.motions[0].frames])
    return "planar" if hypotheses.motions[0].planar else "general", risk, rotation, direction, milliseconds


def _errors(motion: FittedMotion, true: Sequence[Pose]) -> tuple[float, float]:
    to_reference = true[0].inverse()
    rotation = max(
        float(rotation_angle(R.T @ (pose @ to_reference).R)) for R, pose in zip(motion.fit.state.R, true, strict=True)
    )
    truth, found = true[1] @ to_reference, motion.cam2_from_cam1
    length = float(np.linalg.norm(truth.t))
    if length < 1e-9:
        return math.degrees(rotation), 180.0
    cosine = float((found.R.T @ found.t) @ (truth.R.T @ truth.t)) / length
    return math.degrees(rotation), math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def drawn_windows(seeds: range, baselines: Sequence[float], scenes: Sequence[str]) -> Iterator[Window]:
    """Windows of drawn worlds: noise .3, .7 or 1 px, 5, 15 or 30 % outliers, by the seed."""
    from slam_init.datasets.points import open_points

    for scene in scenes:
        for baseline in baselines if scene not in ("rotation", "static") else baselines[:1]:
            for seed in seeds:
                noise_px, outliers = (0.3, 0.7, 1.0)[seed % 3], (0.05, 0.15, 0.3)[seed // 3 % 3]
                values = f"baseline={baseline}&noise_px={noise_px}&outliers={outliers}"
                source = open_points(f"points:{scene}?{values}", seed)
                views = list(source.observations())
                poses = [pose.inverse() for pose in source.groundtruth.world_from_cam]
                live = LiveHypotheses(source.camera, WINDOW_PRIORS)
                for count in VIEWS:
                    judged = judge_window(live, source.camera, views[:count], poses[:count])
                    yield Window(scene, baseline, str(seed), count, *judged)


def reliability_table(windows: Sequence[Window]) -> str:
    """Stated risk against the share of wrong windows."""
    rows = []
    for low, high in RISK_BINS:
        inside = [w for w in windows if w.risk is not None and low <= w.risk.total < high + (high == 1.0)]
        wrong = sum(w.wrong for w in inside)
        stated = float(np.mean([w.risk.total for w in inside if w.risk is not None])) if inside else math.nan
        share = f"{100 * wrong / len(inside):.2f}" if inside else "-"
        rows.append([f"{low:g} to {high:g}", str(len(inside)), f"{100 * stated:.2f}", str(wrong), share])
    return markdown_table(["stated risk", "windows", "mean risk %", "wrong", "wrong %"], rows)


def rule_table(windows: Sequence[Window], max_risk: float) -> str:
    """What a rule on the risk accepts first in each trial, beside the coverage and the time."""
    rows = []
    for scene in dict.fromkeys(w.scene for w in windows):
        for baseline in dict.fromkeys(w.baseline for w in windows if w.scene == scene):
            own = [w for w in windows if (w.scene, w.baseline) == (scene, baseline)]
            trials = list(dict.fromkeys(w.start for w in own))
            first = [
                next((w for w in own if w.start == s and w.risk and w.risk.total <= max_risk), None) for s in trials
            ]
            false = sum(w.wrong for w in first if w is not None)
            waits = [VIEWS[-1] if w is None or w.wrong else w.views - 1 for w in first]
            certain = [w for w in own if w.risk is not None and w.risk.total <= 0.05]
            # 95 % of a two-dimensional Gaussian lie within 2.45 standard deviations.
            covered = [w.direction_deg <= 2.45 * w.risk.direction_sigma_deg for w in certain if w.risk is not None]
            taken = sum(w is not None for w in first)
            rows.append(
                [
                    f"{scene} {baseline:g}",
                    f"{taken - false}/{false}/{len(trials) - taken}",
                    f"{np.mean(waits):.1f}",
                    f"{100 * np.mean(covered):.0f}" if covered else "-",
                    f"{np.median([w.milliseconds for w in own if w.risk is not None] or [math.nan]):.0f}",
                ]
            )
    header = ["scene, baseline", "correct/false/none", "wait (frames)", "within 95 % (%)", "ms a window"]
    return markdown_table(header, rows)


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
    live = LiveHypotheses(source.camera, WINDOW_PRIORS)
    live.propose(pose, (order[0].frame, order[1].frame), rays1, rays2, 0.7)
    hypotheses = live.fitted(order)
    if hypotheses is None:
        raise ValueError("the world of the step table has a map")
    best = hypotheses.motions[0]
    part = tracks.of_views(best.rows)
    works: dict[str, Callable[[], object]] = {
        "a Gauss-Newton step": lambda: fit_window(part, best.fit.state, WINDOW_PRIORS, max_steps=1, tolerance=0.0),
        "the error fields integrated out": lambda: marginalize_fields(
            linearize_with_fields(part, best.fit, WINDOW_PRIORS)
        ),
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


def main() -> int:
    """Log windows and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m slam_init.benchmarks.window_fit")
    parser.add_argument("--seeds", type=int, nargs=2, default=(100_000, 100_020), metavar=("FIRST", "END"))
    parser.add_argument("--baselines", type=float, nargs="+", default=list(BASELINES))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--max-risk", type=float, default=0.005)
    parser.add_argument("--out", type=Path, help="file for the tables")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    windows = []
    for window in drawn_windows(range(*options.seeds), options.baselines, options.scenes):
        windows.append(window)
        if sys.stderr.isatty():
            print(f"\r{len(windows)} windows", end="", file=sys.stderr)
    proposed = [w for w in windows if w.risk is not None]
    text = "\n\n".join(
        [
            f"{len(windows)} windows, {len(proposed)} with a proposed motion.",
            reliability_table(proposed),
            rule_table(windows, options.max_risk),
            step_table(),
        ]
    )
    show(text + "\n", options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
