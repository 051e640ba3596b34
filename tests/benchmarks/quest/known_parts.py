"""A known start and an unknown focal length, quest beside PoseLib: ``python -m tests.benchmarks.quest.known_parts``.

Both begin with the same wrong pose: its rotation is 2 degrees and its direction 10 degrees off. Or both find the focal
length that the two views share. A cell has the share of scenes whose pose is within 5 degrees and the median processor
time; with an unknown focal length also the median error of it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import poselib
from numpy.typing import NDArray

from quest import NoPose, estimate_relative_pose, estimate_shared_focal
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector
from slam_init.methods.poselib import poselib_options, relative_pose_of_poselib
from slam_init.output.tables import markdown_table
from tests.benchmarks.options import positive, run_on_one_thread, save
from tests.benchmarks.quest.cells import FOUND_DEG
from tests.benchmarks.quest.measures import pose_errors_deg
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene

Floats = NDArray[np.float64]

_SCENES, _OUTLIERS, _MATCHES, _NOISE_PX, _THRESHOLD_PX = (
    ("general .15", "general .03", "desk .15"),
    (0.3, 0.7),
    500,
    0.7,
    2.0,
)
_CAMERA = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [FOCAL_PX, 0.0, 0.0]}
_RANSAC = {"min_iterations": 100}


def _points(scene: Scene) -> list[Floats]:
    return [np.ascontiguousarray(FOCAL_PX * rays[:, :2] / rays[:, 2:]) for rays in (scene.bearings1, scene.bearings2)]


def _wrong_pose(scene: Scene, rng: np.random.Generator) -> tuple[Floats, Floats]:
    turns = [angle * axis / np.linalg.norm(axis) for angle, axis in zip((2, 10), rng.normal(size=(2, 3)), strict=True)]
    turned, shifted = (rotation_from_vector(np.radians(turn)) for turn in turns)
    return turned @ scene.R, shifted @ scene.t


def _by_quest(scene: Scene, start: tuple[Floats, Floats] | None, seed: int) -> tuple[Any, float | None]:
    found = estimate_relative_pose(
        scene.bearings1, scene.bearings2, threshold_rad=_THRESHOLD_PX / FOCAL_PX, seed=seed, initial_pose=start
    )
    return (None if isinstance(found, NoPose) else found), None


def _by_poselib(scene: Scene, start: tuple[Floats, Floats] | None, seed: int) -> tuple[Any, float | None]:
    begin = None
    if start is not None:
        begin = poselib.CameraPose()
        begin.q, begin.t = quaternion_from_matrix(start[0]), start[1]
    x1, x2 = _points(scene)
    pose, _ = relative_pose_of_poselib(x1, x2, _CAMERA, _THRESHOLD_PX, {**_RANSAC, "seed": seed}, begin)
    return pose, None


def _focal_by_quest(scene: Scene, _start: object, seed: int) -> tuple[Any, float | None]:
    points1, points2 = _points(scene)
    found = estimate_shared_focal(points1, points2, (0.0, 0.0), threshold_px=_THRESHOLD_PX, seed=seed)
    return (None, None) if isinstance(found, NoPose) else (found.pose, found.focal_px)


def _focal_by_poselib(scene: Scene, _start: object, seed: int) -> tuple[Any, float | None]:
    options = poselib_options(_THRESHOLD_PX, {**_RANSAC, "seed": seed})
    pair, _ = poselib.estimate_shared_focal_relative_pose(*_points(scene), np.zeros(2), *options)
    return pair.pose, float(pair.camera1.focal())


#: Title, function, and whether it gets the start.
_COLUMNS = (
    ("quest", _by_quest, False),
    ("quest, start", _by_quest, True),
    ("PoseLib min 100", _by_poselib, False),
    ("PoseLib, start", _by_poselib, True),
    ("quest, focal length", _focal_by_quest, False),
    ("PoseLib, focal length", _focal_by_poselib, False),
)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, and write it to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.known_parts", allow_abbrev=False)
    parser.add_argument("--trials", type=positive, default=100, help="scenes a row (default 100)")
    parser.add_argument("--out", type=Path, help="folder for known_parts.md")
    options = parser.parse_args(argv)
    rows = []
    for name in _SCENES:
        for outliers in _OUTLIERS:
            cells: dict[str, list[tuple[bool, float, float]]] = {title: [] for title, *_ in _COLUMNS}
            for seed in range(options.trials):
                rng = np.random.default_rng((53, seed))
                scene = draw_scene(SCENES[name], rng, matches=_MATCHES, outlier_share=outliers, noise_px=_NOISE_PX)
                start = _wrong_pose(scene, rng)
                for title, run, with_start in _COLUMNS:
                    begin = time.process_time()
                    pose, focal_px = run(scene, start if with_start else None, seed)
                    time_ms = 1e3 * (time.process_time() - begin)
                    error = 180.0 if pose is None else max(pose_errors_deg(pose.R, pose.t, scene.R, scene.t))
                    off = np.nan if focal_px is None else abs(focal_px / FOCAL_PX - 1)
                    cells[title].append((error < FOUND_DEG, time_ms, 100 * off))
            rows.append([name, f"{outliers:.0%}", *(_cell(found) for found in cells.values())])
    table = markdown_table(["scene", "outliers", *(title for title, *_ in _COLUMNS)], rows)
    note = f"{options.trials} scenes a row, {_MATCHES} matches, {_NOISE_PX} px; PoseLib {poselib.__version__}. Pose "
    note += f"within {FOUND_DEG:g} degrees, % / median time, ms / median error of the focal length, %."
    save(options.out, "known_parts.md", f"{note}\n\n{table}\n")


def _cell(found: Sequence[tuple[bool, float, float]]) -> str:
    right, time_ms, off = np.array(found, float).T
    known = off[np.isfinite(off)]
    text = f"{100 * right.mean():.0f} / {np.median(time_ms):.1f}"
    return f"{text} / {np.median(known):.1f}" if len(known) else text


if __name__ == "__main__":
    run_on_one_thread()
    main()
