"""How often the initialization is right: ``python -m slam_init.benchmarks.initialization``.

Runs the pipeline with its default options on every real sequence below ``SLAM_INIT_DATA`` (a folder with
``camera.yaml`` and ``groundtruth.txt`` is one) and on some seeds of every synthetic scene, and prints one table of
each. An accepted map is

* *correct* where every keyframe is within 5 degrees in rotation and 15 in the direction of its baseline,
* *strict* where it is within 1 and 5 degrees (a strict one is also counted as correct),
* *false* otherwise; where the camera never translates, every accepted map is false.

No map is *none*, with its reason. The errors are those of :func:`slam_init.evaluation.metrics.compare_with_groundtruth`.

Where a camera first turns and then moves, the parallax suffices no earlier than for an initializer that begins with the
first motion and has seen nothing of the turn: by how much the map comes later than that one's is told as well.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import numpy as np

from sequences_synth import SCENES
from slam_init.benchmarks.image_pairs import DIRECTION_UNKNOWN, STILL, data_folder
from slam_init.benchmarks.options import positive, show
from slam_init.output.tables import markdown_table, number

__all__ = [
    "Outcome",
    "Task",
    "count",
    "delay_text",
    "find_sequences",
    "from_first_motion",
    "judge",
    "main",
    "run_all",
    "run_task",
]

#: Its board is held by a person before a fixed camera: no single motion explains the image.
_NOT_ONE_MOTION = ("planar/opencv_chessboard",)
#: Where the camera never translates.
_STILL = (STILL, "synth:rotation", "synth:static")
#: Turns only, and moves later.
_MOVES_LATER = "synth:rotate-then-move"
#: With ``--every``: a start must leave half a second of video.
_LEAST_FRAMES = 15

#: Rendered worlds are in metres; their cameras that turn stand still to the last bit.
_AT_REST_M = 1e-9

_CORRECT_DEG = (5.0, 15.0)
_STRICT_DEG = (1.0, 5.0)


@dataclass(frozen=True)
class Task:
    """One run: of what, and from which frame on.

    Attributes
    ----------
    label : str
        Name in the table: path below the data folder, or ``synth:NAME``.
    source : str
        What the command line would take.
    seed, start : int
    """

    label: str
    source: str
    seed: int = 0
    start: int = 0


@dataclass(frozen=True)
class Outcome:
    """What became of a run; the figures are None where there is no map (or no such truth).

    Attributes
    ----------
    task : Task
    reason : str or None
        None where a map was accepted.
    frames_to_init, landmarks : int or None
    rotation_error_deg, direction_error_deg, parallax_deg, rmse_px : float or None
    """

    task: Task
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
    truth = summary.get("ground_truth") or {}
    return Outcome(
        task,
        None,
        frames_to_init=result.frames_to_init,
        landmarks=len(result.map.points),
        rotation_error_deg=truth.get("rotation_error_deg"),
        direction_error_deg=truth.get("direction_error_deg"),
        parallax_deg=result.map.median_parallax_deg,
        rmse_px=result.map.reprojection_rmse_px,
    )


def judge(outcome: Outcome) -> str:
    """``strict``, ``correct``, ``false`` or ``none``. A map that the truth does not confirm is false."""
    if outcome.reason is not None:
        return "none"
    if outcome.task.label in _STILL:
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
    """Cells ``correct, strict, false, none, reasons, median frames to init`` of a group of runs."""
    verdicts = Counter(judge(outcome) for outcome in outcomes)
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


def find_sequences(data: Path) -> list[str]:
    """Paths below ``data`` of the sequences with a camera and a ground truth, sorted."""
    folders = (camera.parent for camera in data.rglob("camera.yaml") if (camera.parent / "groundtruth.txt").is_file())
    return sorted(name for folder in folders if (name := folder.relative_to(data).as_posix()) not in _NOT_ONE_MOTION)


def run_all(tasks: Sequence[Task], jobs: int = 1) -> list[Outcome]:
    """The outcomes in the order of the tasks, whatever the number of processes."""
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
    # Spawned, not forked: a fork of a process with threads (OpenCV's, BLAS's) may hang.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures: list[Future[Outcome]] = [pool.submit(run_task, task) for task in tasks]
        yield from (future.result() for future in as_completed(futures))


# -- tables ---------------------------------------------------------------------------------------


def _real_tasks(data: Path, every: int | None) -> list[Task]:
    from slam_init.datasets import open_source

    tasks = []
    for name in find_sequences(data):
        frames = len(open_source(str(data / name))) if every else 0
        starts = range(0, max(frames - _LEAST_FRAMES + 1, 1), every or 1)
        tasks += [Task(name, str(data / name), start=start) for start in starts]
    return tasks


def _real_table(outcomes: Sequence[Outcome]) -> str:
    header = ["sequence", "result", "judged", "frames to init", "rotation (deg)", "direction (deg)"]
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
                judge(outcome),
                number(outcome.frames_to_init, 0),
                number(outcome.rotation_error_deg),
                direction,
                number(outcome.landmarks, 0),
                number(outcome.parallax_deg),
                number(outcome.rmse_px),
            ]
        )
    note = "In parentheses, and not judged: the ground truth does not know the direction of so short a baseline."
    return markdown_table(header, rows) + f"\n\n{note}"


def _count_table(outcomes: Sequence[Outcome], what: str) -> str:
    header = [what, "runs", "correct", "of which strict", "false", "none", "reasons of none", "median frames to init"]
    labels = dict.fromkeys(outcome.task.label for outcome in outcomes)
    groups = {label: [outcome for outcome in outcomes if outcome.task.label == label] for label in labels}
    rows = [[label.removeprefix("synth:"), str(len(group)), *count(group)] for label, group in groups.items()]
    if len(groups) > 1:
        rows.append(["all", str(len(outcomes)), *count(outcomes)])
    return markdown_table(header, rows)


# -- first a turn, then a motion ------------------------------------------------------------------


def from_first_motion(task: Task) -> Task:
    """The same source, from the last frame before its camera's first motion on."""
    from slam_init.datasets import open_source

    source = open_source(task.source, task.seed)
    if source.groundtruth is None:
        raise ValueError(f"{task.source}: no ground truth says when it moves")
    poses = [source.groundtruth.at(time_s) for time_s in source.timestamps_s]
    places = np.array([np.full(3, np.nan) if pose is None else pose.t for pose in poses])
    moved = np.linalg.norm(places - places[0], axis=1) > _AT_REST_M
    if not moved.any():
        raise ValueError(f"{task.source}: the camera never moves")
    return replace(task, start=int(np.argmax(moved)) - 1)


def delay_text(whole: Sequence[Outcome], from_motion: Sequence[Outcome]) -> str:
    """By how many frames a correct map comes later than that of an initializer that begins with the motion."""
    delays = [
        one.frames_to_init - (other.task.start + other.frames_to_init)
        for one, other in zip(whole, from_motion, strict=True)
        if {judge(one), judge(other)} <= {"strict", "correct"}
        if one.frames_to_init is not None and other.frames_to_init is not None
    ]
    if not delays:
        return "No run has a correct map both with its turn and without it: no delay to tell."
    return (
        f"`{_MOVES_LATER.removeprefix('synth:')}`: the map comes {median(delays):g} frames later (median; "
        f"{min(delays)} to {max(delays)}; {len(delays)} of {len(whole)} runs) than that of an initializer that begins "
        "with the motion."
    )


# -- command line ---------------------------------------------------------------------------------


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m slam_init.benchmarks.initialization", allow_abbrev=False)
    parser.description = "Count correct, false and missing initializations. Real sequences: below SLAM_INIT_DATA."
    parser.add_argument("--only", choices=("real", "synthetic"), help="one of the two tables")
    parser.add_argument("--seeds", type=positive, default=10, metavar="N", help="of each scene (default: 10)")
    parser.add_argument("--scenes", default=",".join(SCENES), metavar="A,B", help="synthetic scenes (default: all)")
    parser.add_argument("--every", type=positive, metavar="K", help="real: start at every K-th frame, and count")
    parser.add_argument("--jobs", type=positive, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    arguments = parser.parse_args(argv)
    scenes = arguments.scenes.split(",")
    if unknown := [scene for scene in scenes if scene not in SCENES]:
        parser.error(f"unknown scene {unknown[0]!r}: use {', '.join(SCENES)}")

    data = data_folder()
    real = [] if arguments.only == "synthetic" else _real_tasks(data, arguments.every)
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
