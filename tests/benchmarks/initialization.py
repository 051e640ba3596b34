"""Counts correct and false initializations: ``python -m tests.benchmarks.initialization``.

The program runs the pipeline with default options on every real sequence below ``SLAM_INIT_DATA`` (a folder with
``camera.yaml`` and ``groundtruth.txt``) and on several seeds of every synthetic scene. It prints one table of each. An
accepted map is

* *correct* if every keyframe is within 5 degrees in rotation and within 15 degrees in the direction of its baseline,
* *strict* if every keyframe is within 1 and 5 degrees (a strict map is also counted as correct),
* *false* otherwise; if the camera never translates, every accepted map is false.

A run without a map is *none*, with its reason. The errors are those of
:func:`slam_init.evaluation.metrics.compare_with_groundtruth`.

In one scene the camera first rotates and then translates. The parallax cannot suffice earlier there than for an
initializer that starts at the first translation and has not seen the rotation. The program also prints the delay
relative to such an initializer.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import numpy as np

from sequences_synth import SCENES, STANDARD_SCENES
from slam_init.output.tables import markdown_table, number
from tests.benchmarks.image_pairs import DIRECTION_UNKNOWN, STATIC_SEQUENCE, data_folder
from tests.benchmarks.options import positive, show

#: Excluded: a person holds the chessboard in front of a fixed camera, so no single motion explains the image.
_SEVERAL_MOTIONS = ("planar/opencv_chessboard",)
#: Sources whose camera never translates.
NO_TRANSLATION = (STATIC_SEQUENCE, "synth:rotation", "synth:static", "synth:pan")
#: The camera first rotates and then translates.
_MOVES_LATER = "synth:rotate-then-move"
#: With ``--every``, a run starts only where this many frames are left: half a second of video.
_MIN_FRAMES = 15

#: Rendered worlds are in metres, and the position of a rotation-only camera is exactly constant.
_AT_REST_M = 1e-9

_CORRECT_DEG = (5.0, 15.0)
_STRICT_DEG = (1.0, 5.0)


@dataclass(frozen=True)
class Task:
    """One run: source, seed and start frame."""

    #: Name in the table: path below the data folder, or ``synth:NAME``.
    label: str
    #: SOURCE of the command line.
    source: str
    seed: int = 0
    start: int = 0


@dataclass(frozen=True)
class Outcome:
    """Result of a run. The figures are None if there is no map, or if the ground truth does not hold the value."""

    task: Task
    #: None if a map was accepted.
    reason: str | None
    frames_to_init: int | None = None
    landmarks: int | None = None
    rotation_error_deg: float | None = None
    direction_error_deg: float | None = None
    parallax_deg: float | None = None
    rmse_px: float | None = None


def run_task(task: Task) -> Outcome:
    """Run the pipeline with default options, as ``slam-init run SOURCE --seed N --start K`` does."""
    import cv2

    from slam_init.config import Config
    from slam_init.datasets import open_source
    from slam_init.runner import run

    cv2.setNumThreads(1)  # one process, one core: --jobs is the number of cores in use
    source = open_source(task.source, task.seed)
    if source.camera is None:
        raise ValueError(f"{task.source}: no camera; the benchmark runs on calibrated sequences only")
    result, summary = run(source, source.camera, Config(seed=task.seed), start=task.start)
    if result.map is None:
        return Outcome(task, result.reason)
    errors = summary.ground_truth
    return Outcome(
        task,
        None,
        frames_to_init=result.frames_to_init,
        landmarks=len(result.map.points),
        rotation_error_deg=None if errors is None else errors.rotation_error_deg,
        direction_error_deg=None if errors is None else errors.direction_error_deg,
        parallax_deg=result.map.median_parallax_deg,
        rmse_px=result.map.reprojection_rmse_px,
    )


def classify(outcome: Outcome) -> str:
    """Return ``strict``, ``correct``, ``false`` or ``none``. A map without a known error is false."""
    if outcome.reason is not None:
        return "none"
    if outcome.task.label in NO_TRANSLATION:
        return "false"
    errors = [outcome.rotation_error_deg]
    if not outcome.task.label.startswith(DIRECTION_UNKNOWN):
        errors.append(outcome.direction_error_deg)

    def within(bounds: tuple[float, float]) -> bool:
        return all(error is not None and error < bound for error, bound in zip(errors, bounds, strict=False))

    if within(_STRICT_DEG):
        return "strict"
    return "correct" if within(_CORRECT_DEG) else "false"


def count(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the cells ``correct, strict, false, none, reasons, median frames to init`` of a group of runs."""
    verdicts = Counter(classify(outcome) for outcome in outcomes)
    reasons = Counter(outcome.reason for outcome in outcomes if outcome.reason is not None)
    frames = [outcome.frames_to_init for outcome in outcomes if outcome.frames_to_init is not None]
    return [
        str(verdicts["correct"] + verdicts["strict"]),
        str(verdicts["strict"]),
        str(verdicts["false"]),
        str(verdicts["none"]),
        ", ".join(f"{n} {reason}" for reason, n in reasons.most_common()) or "-",
        f"{median(frames):g}" if frames else "-",
    ]


def find_sequences(data: str | os.PathLike[str]) -> list[str]:
    """Return the paths below ``data`` of the sequences with a camera and a ground truth, sorted."""
    data = Path(data)
    folders = (camera.parent for camera in data.rglob("camera.yaml") if (camera.parent / "groundtruth.txt").is_file())
    return sorted(name for folder in folders if (name := folder.relative_to(data).as_posix()) not in _SEVERAL_MOTIONS)


def run_all(tasks: Sequence[Task], jobs: int = 1) -> list[Outcome]:
    """Run all tasks and return the outcomes in the order of the tasks, for any number of processes."""
    from tqdm import tqdm

    outcomes: dict[Task, Outcome] = {}
    with tqdm(total=len(tasks), unit="run", disable=None, leave=False) as bar:
        for outcome in _outcomes(tasks, jobs):
            outcomes[outcome.task] = outcome
            bar.update()
    return [outcomes[task] for task in tasks]


def _outcomes(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    if jobs == 1:
        yield from map(run_task, tasks)
        return
    # Processes are spawned, because a fork of a process with threads (of OpenCV or BLAS) can hang.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures: list[Future[Outcome]] = [pool.submit(run_task, task) for task in tasks]
        yield from (future.result() for future in as_completed(futures))


# -- tables ---------------------------------------------------------------------------------------


def real_tasks(data: str | os.PathLike[str], every: int | None) -> list[Task]:
    """Return the runs on the real sequences: from every k-th frame on, or from the first frame if ``every`` is None."""
    from slam_init.datasets import open_source

    tasks = []
    for name in find_sequences(data):
        frames = len(open_source(str(Path(data) / name))) if every else 0
        starts = range(0, max(frames - _MIN_FRAMES + 1, 1), every or 1)
        tasks += [Task(name, str(Path(data) / name), start=start) for start in starts]
    return tasks


def _real_table(outcomes: Sequence[Outcome]) -> str:
    header = ["sequence", "result", "class", "frames to init", "rotation (deg)", "direction (deg)"]
    header += ["landmarks", "parallax (deg)", "reprojection rmse (px)"]
    rows = []
    for outcome in outcomes:
        direction = number(outcome.direction_error_deg)
        if outcome.task.label.startswith(DIRECTION_UNKNOWN) and outcome.direction_error_deg is not None:
            direction = f"({direction})"
        rows.append(
            [
                outcome.task.label,
                outcome.reason or "initialized",
                classify(outcome),
                number(outcome.frames_to_init, 0),
                number(outcome.rotation_error_deg),
                direction,
                number(outcome.landmarks, 0),
                number(outcome.parallax_deg),
                number(outcome.rmse_px),
            ]
        )
    note = "Directions in parentheses are not checked: the ground truth does not resolve them for short baselines."
    return markdown_table(header, rows) + f"\n\n{note}"


def _count_table(outcomes: Sequence[Outcome], first_heading: str) -> str:
    header = [first_heading, "runs", "correct", "of which strict", "false", "none", "reasons", "median frames to init"]
    labels = dict.fromkeys(outcome.task.label for outcome in outcomes)
    groups = {label: [outcome for outcome in outcomes if outcome.task.label == label] for label in labels}
    rows = [[label.removeprefix("synth:"), str(len(group)), *count(group)] for label, group in groups.items()]
    if len(groups) > 1:
        rows.append(["all", str(len(outcomes)), *count(outcomes)])
    return markdown_table(header, rows)


# -- first a rotation, then a translation ---------------------------------------------------------


def from_first_motion(task: Task) -> Task:
    """Return the same run, started at the last frame before the first translation of the camera."""
    from slam_init.datasets import open_source

    source = open_source(task.source, task.seed)
    if source.groundtruth is None:
        raise ValueError(f"{task.source}: the source has no ground truth, so the first translation is not known")
    poses = [source.groundtruth.at(time_s) for time_s in source.timestamps_s]
    positions = np.array([np.full(3, np.nan) if pose is None else pose.t for pose in poses])
    moved = np.linalg.norm(positions - positions[0], axis=1) > _AT_REST_M
    if not moved.any():
        raise ValueError(f"{task.source}: the camera never moves")
    return replace(task, start=int(np.argmax(moved)) - 1)


def delay_text(whole: Sequence[Outcome], from_motion: Sequence[Outcome]) -> str:
    """Describe by how many frames the map is later than that of an initializer that starts at the translation."""
    delays = [
        one.frames_to_init - (other.task.start + other.frames_to_init)
        for one, other in zip(whole, from_motion, strict=True)
        if {classify(one), classify(other)} <= {"strict", "correct"}
        if one.frames_to_init is not None and other.frames_to_init is not None
    ]
    if not delays:
        return "No run has a correct map both with and without the rotation, so no delay is measured."
    return (
        f"`{_MOVES_LATER.removeprefix('synth:')}`: the map comes {median(delays):g} frames later (median; "
        f"{min(delays)} to {max(delays)}; {len(delays)} of {len(whole)} runs) than that of an initializer that starts "
        "at the translation."
    )


# -- command line ---------------------------------------------------------------------------------


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.initialization", allow_abbrev=False)
    parser.description = "Count correct, false and missing initializations. Real sequences: below SLAM_INIT_DATA."
    parser.add_argument("--only", choices=("real", "synthetic"), help="one of the two tables")
    parser.add_argument("--seeds", type=positive, default=10, metavar="N", help="of each scene (default: 10)")
    scenes_help = "synthetic scenes (default: the nine standard ones)"
    parser.add_argument("--scenes", default=",".join(STANDARD_SCENES), metavar="A,B", help=scenes_help)
    parser.add_argument("--every", type=positive, metavar="K", help="real: start at every K-th frame, and count")
    parser.add_argument("--jobs", type=positive, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    arguments = parser.parse_args(argv)
    scenes = arguments.scenes.split(",")
    if unknown := [scene for scene in scenes if scene not in SCENES]:
        parser.error(f"unknown scene {unknown[0]!r}: use {', '.join(SCENES)}")

    data = data_folder()
    real = [] if arguments.only == "synthetic" else real_tasks(data, arguments.every)
    seeds = range(arguments.seeds)
    synthetic = [Task(f"synth:{scene}", f"synth:{scene}", seed) for scene in scenes for seed in seeds]
    if arguments.only == "real":
        synthetic = []
    if not real and arguments.only != "synthetic":
        print(f"no sequence below {data}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
        if arguments.only == "real":
            return 2
    later = [from_first_motion(task) for task in synthetic if task.label == _MOVES_LATER]
    outcomes = run_all([*real, *synthetic, *later], arguments.jobs)
    of_synthetic, of_later = outcomes[len(real) :][: len(synthetic)], outcomes[len(real) + len(synthetic) :]
    tables = []
    if real:
        of_real = outcomes[: len(real)]
        tables.append(_count_table(of_real, "sequence") if arguments.every else _real_table(of_real))
    if synthetic:
        tables.append(_count_table(of_synthetic, "scene"))
    if later:
        tables.append(delay_text([o for o in of_synthetic if o.task.label == _MOVES_LATER], of_later))
    show("\n\n".join(tables) + "\n", arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
