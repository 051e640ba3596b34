"""Robust two-view estimators on the same matches: ``python -m tests.benchmarks.quest.robust_comparison --out DIR``.

The methods are quest, OpenCV's USAC, PoseLib and COLMAP (:mod:`tests.benchmarks.quest.robust_methods`) on the scenes of
:mod:`tests.benchmarks.quest.scenes`, all with the same threshold, on one thread. The error of a pose is the larger of
the angle between the rotations and the angle between the directions of translation, its sign included.

By default one factor varies at a time, and the others have the middle value of their lists; ``--full`` runs every
combination (hours). On a plane two poses explain both images. "Kept" counts the trials in which one of the returned
poses is right; for quest these are the pose and at most one alternative. It is a share of the trials that refinement
from the truth on the true inliers solves: in the other trials the data do not determine the pose.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.options import choice_list, number_list, positive, progress, run_on_one_thread, save
from tests.benchmarks.quest.cells import (
    FOUND_DEG,
    auc_cell,
    errors_cell,
    kept_cell,
    success_cell,
    times_cell,
    verdicts_cell,
)
from tests.benchmarks.quest.measures import accuracy
from tests.benchmarks.quest.robust_methods import METHODS, available, limit_threads
from tests.benchmarks.quest.robust_trials import Cell, Trial, full_grid, run_trials, star_grid, warm_up, write_csv
from tests.benchmarks.quest.scenes import SCENES
from tests.benchmarks.tables import markdown_table

_OUTLIERS = [0.1, 0.5, 0.7]
_ALL_OUTLIERS = [0.1, 0.3, 0.5, 0.7, 0.8]
_NOISES_PX = [0.3, 0.7, 1.0]
_MATCHES = [300, 1000, 2000]
_ALL_MATCHES = [100, 300, 1000, 2000, 5000]


def _kept(trials: Sequence[Trial]) -> str:
    return kept_cell([trial for trial in trials if trial.oracle_error_deg < FOUND_DEG])


#: Title -> cell of a group of trials with one method.
_MEASURES: dict[str, Callable[[Sequence[Trial]], str]] = {
    "Success within 1 / 5 / 10 deg, %": success_cell,
    "AUC at 5 / 10 / 20 deg, %": auc_cell,
    "Truth among the poses kept, % of what the oracle solves (number of poses kept)": _kept,
    "Median error of rotation / direction, deg": errors_cell,
    "Time, ms: median / 95th percentile": times_cell,
    'Answered "only turned" / no pose, %': verdicts_cell,
}


_SUMMARY = "First pose within 5 deg, % / truth among the poses kept, % / median time, ms"


def tables(trials: Sequence[Trial]) -> str:
    """All tables in markdown: each measure by scene and outliers, noise, matches; then pure rotation."""
    methods = list(dict.fromkeys(trial.method for trial in trials))
    moving = [trial for trial in trials if trial.scene != "rotation"]
    turning = [trial for trial in trials if trial.scene == "rotation"]
    parts = []
    if moving:
        parts.append(f"**{_SUMMARY}**\n\n{_summary(moving, methods)}")
        for title, measure in _MEASURES.items():
            parts.append(f"**{title}**\n\n{_table(moving, methods, measure)}")
    if turning:
        parts.append(f"**Pure rotation**\n\n{_rotation_table(turning, methods)}")
    return "\n\n".join(parts) + "\n"


def _summary(trials: Sequence[Trial], methods: Sequence[str]) -> str:
    """All baselines, noises and numbers of matches of a scene together."""
    groups: dict[tuple[str, float], dict[str, list[Trial]]] = {}
    for trial in trials:
        family = trial.scene.split(" .")[0]
        groups.setdefault((family, trial.outlier_share), {name: [] for name in methods})[trial.method].append(trial)
    rows = []
    for (family, share), group in groups.items():
        cells = []
        for name in methods:
            found = 100 * accuracy([trial.error_deg for trial in group[name]], FOUND_DEG)
            time_ms = np.median([trial.time_ms for trial in group[name]])
            cells.append(f"{found:.0f} / {_kept(group[name]).split(' ')[0]} / {time_ms:.1f}")
        rows.append([family, f"{100 * share:.0f} %", str(len(group[methods[0]])), *cells])
    return markdown_table(["scene", "outliers", "trials", *methods], rows)


def _table(trials: Sequence[Trial], methods: Sequence[str], measure: Callable[[Sequence[Trial]], str]) -> str:
    groups: dict[Cell, dict[str, list[Trial]]] = {}
    for trial in trials:
        cell = Cell(trial.scene, trial.outlier_share, trial.noise_px, trial.matches)
        groups.setdefault(cell, {name: [] for name in methods})[trial.method].append(trial)
    rows = [
        [cell.scene, f"{100 * cell.outlier_share:.0f} %", f"{cell.noise_px:g}", str(cell.matches)]
        + [measure(group[name]) for name in methods]
        for cell, group in groups.items()
    ]
    return markdown_table(["scene", "outliers", "noise (px)", "matches", *methods], rows)


def _rotation_table(trials: Sequence[Trial], methods: Sequence[str]) -> str:
    rows = []
    for name in methods:
        for share in sorted({trial.outlier_share for trial in trials}):
            group = [trial for trial in trials if trial.method == name and trial.outlier_share == share]
            recognized = sum(trial.kind == "rotation" for trial in group)
            none = sum(trial.kind == "none" for trial in group)
            errors = [trial.rotation_error_deg for trial in group if trial.kind != "none"]
            spread = f"{np.median(errors):.3f} / {max(errors):.3f}" if errors else "-"
            counts = [len(group), recognized, len(group) - recognized - none, none]
            rows.append([name, f"{100 * share:.0f} %", *map(str, counts), spread])
    header = ["method", "outliers", "trials", "recognized", "says it moved", "no pose"]
    note = "OpenCV and PoseLib give no verdict: a translation is all that they can answer."
    return markdown_table([*header, "rotation error (deg): median / worst"], rows) + f"\n\n{note}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the trials and print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.robust_comparison", allow_abbrev=False)
    parser.description = "Compare robust two-view estimators on synthetic matches, on one thread."
    parser.add_argument("--scenes", type=choice_list(list(SCENES)), default=list(SCENES), metavar="A,B")
    parser.add_argument("--outliers", type=number_list(float, 0, 0.95), metavar="X,Y", help="shares (default .1,.5,.7)")
    parser.add_argument("--noise", type=number_list(float, 0, 10), default=_NOISES_PX, metavar="X,Y", help="px")
    parser.add_argument(
        "--matches", type=number_list(int, 10, 100_000), metavar="N,M", help="counts (default 300,1000,2000)"
    )
    parser.add_argument("--methods", type=choice_list(list(METHODS)), default=list(METHODS), metavar="A,B")
    parser.add_argument("--trials", type=positive, default=10, metavar="N", help="scenes a row (default 10)")
    parser.add_argument("--threshold-px", type=float, default=2.0, metavar="X", help="of all methods (default 2)")
    parser.add_argument("--full", action="store_true", help="every combination of the complete lists")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the scenes (default 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write robust_comparison.md and .csv there")
    options = parser.parse_args(argv)
    methods, missing = available(options.methods)
    if missing:
        print(f"not installed, left out: {', '.join(missing)} (pip install '.[bench]')", file=sys.stderr)
    if not methods:
        parser.error("no method is left")
    outliers = options.outliers or (_ALL_OUTLIERS if options.full else _OUTLIERS)
    matches = options.matches or (_ALL_MATCHES if options.full else _MATCHES)
    cells = (full_grid if options.full else star_grid)(options.scenes, outliers, options.noise, matches)
    limit_threads()
    warm_up(methods)
    run = run_trials(cells, methods, options.trials, threshold_px=options.threshold_px, seed=options.seed)
    trials = list(progress(run, "trial", len(cells) * options.trials * len(methods)))
    if options.out is not None:
        write_csv(trials, options.out / "robust_comparison.csv")
    title = (
        f"{options.trials} scenes a row, threshold {options.threshold_px:g} px at a focal length of 458 px, one thread."
    )
    save(options.out, "robust_comparison.md", f"{title}\n\n{tables(trials)}")
    return 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
