"""Robust two-view estimators on real images: ``python -m tests.benchmarks.real_pairs --out DIR``.

The methods of :mod:`tests.benchmarks.quest.robust_methods` run on the same matches of all pairs of
:mod:`tests.benchmarks.image_pairs`: the pair sets below ``SLAM_INIT_DATA``, the chessboard with its corners, and
pairs of frames of the sequences at several steps. The error of a pose is the larger of two angles: that between the
rotations, and that between the directions of translation. If the ground truth does not resolve the direction, only the
rotation counts.

The first table compares quest with each other method, pair by pair: the difference of the AUC, with a 95 % interval by
the bootstrap over pairs.

The column "true" is the share of matches that are within the threshold of the true epipolar geometry and in front of
both cameras. It is the largest share of inliers that a method can find.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.image_pairs import (
    DIRECTION_UNKNOWN,
    STATIC_SEQUENCE,
    ImagePair,
    chessboard_pairs,
    find_sequences,
    pair_set,
    sequence_pairs,
    true_matches,
)
from tests.benchmarks.options import choice_list, data_folder, number_list, positive, progress, run_on_one_thread, save
from tests.benchmarks.quest.cells import auc_cell, errors_cell, kept_cell, times_cell, verdicts_cell
from tests.benchmarks.quest.robust_methods import METHODS, Estimate, available, limit_threads
from tests.benchmarks.quest.robust_trials import Answer, evaluate, warm_up
from tests.benchmarks.tables import markdown_table

Floats = NDArray[np.float64]

#: Smallest number of matches that quest accepts. A pair with fewer matches counts as failed for all methods.
_MIN_MATCHES = 10
_CHESSBOARD = "planar/opencv_chessboard"
#: Steps of a sequence of fewer frames: photographs, short clips, videos.
_STEPS = ((25, [1, 2, 3]), (100, [2, 10, 25]), (10**9, [5, 15, 40]))
#: Degrees of the AUC, resamples of the bootstrap, and its seed.
_AUC_DEG, _RESAMPLES, _SEED = (5.0, 10.0, 20.0), 5000, 0


@dataclass(frozen=True, eq=False)
class Group:
    """Pairs that make one row of the tables."""

    name: str
    #: Returns an iterator over the pairs.
    read: Callable[[], Iterator[ImagePair]]
    #: Only the rotation is compared.
    rotation_only: bool


def steps_of(frames: int) -> list[int]:
    """Three baselines of a sequence: neighbours, some frames, and as far as matches reach."""
    return next(steps for most, steps in _STEPS if frames < most)


def groups(data: str | os.PathLike[str], steps: Sequence[int] | None, limit: int) -> list[Group]:
    """Return all groups of pairs below a folder of data, with up to ``limit`` pairs of each sequence and step."""
    data = Path(data)
    from slam_init.datasets import open_source

    found = [
        Group(name, partial(pair_set, path.parent), name.startswith(DIRECTION_UNKNOWN))
        for path in sorted(data.rglob("pairs.json"))
        if "T_0to1" in path.read_text(encoding="utf-8")
        for name in [path.parent.relative_to(data).as_posix()]
    ]
    if (data / _CHESSBOARD / "corners.txt").is_file():
        found.append(Group(f"{_CHESSBOARD}, corners", partial(chessboard_pairs, data / _CHESSBOARD), False))
    for name in find_sequences(data):
        source = open_source(str(data / name))
        found += [
            Group(
                f"{name}, step {step}",
                partial(sequence_pairs, source, step, limit),
                name.startswith(DIRECTION_UNKNOWN) or name == STATIC_SEQUENCE,
            )
            for step in (steps or steps_of(len(source)))
            if step < len(source)
        ]
    return found


@dataclass(frozen=True, eq=False)
class _Outcome:
    """The answers of each method come pair by pair, with all seeds of a pair together."""

    matches: list[int]
    true_shares: list[float]
    answers: dict[str, list[Answer]]


def run_group(group: Group, methods: Sequence[str], threshold_px: float, seeds: int = 1) -> _Outcome:
    """Run all methods on all pairs of a group, with each seed."""
    outcome = _Outcome([], [], {name: [] for name in methods})
    for pair in group.read():
        threshold_rad = threshold_px / pair.focal_px
        outcome.matches.append(len(pair.bearings1))
        if len(pair.bearings1) >= _MIN_MATCHES:
            found = true_matches(pair, pair.bearings1, pair.bearings2, threshold_rad)
            outcome.true_shares.append(float(found.mean()))
        for name in methods:
            for seed in range(seeds):
                outcome.answers[name].append(_answer(pair, name, threshold_rad, seed, group.rotation_only))
    return outcome


def _answer(pair: ImagePair, method: str, threshold_rad: float, seed: int, rotation_only: bool) -> Answer:
    few = len(pair.bearings1) < _MIN_MATCHES
    run = METHODS[method][1]
    estimate = Estimate((), 0.0, "none") if few else run(pair.bearings1, pair.bearings2, threshold_rad, seed)
    return evaluate(method, estimate, pair.cam2_from_cam1.R, pair.cam2_from_cam1.t, rotation_only=rotation_only)


_TABLES: dict[str, Callable[[Sequence[Answer]], str]] = {
    "AUC at 5 / 10 / 20 deg, %": auc_cell,
    "Truth within 5 deg among the poses kept, % (number of poses kept)": kept_cell,
    "Median error of rotation / direction, deg": errors_cell,
    'Answered "rotation only" / no pose, %': verdicts_cell,
    "Time, ms: median / 95th percentile": times_cell,
}


def _tables(outcomes: dict[Group, _Outcome], methods: Sequence[str]) -> str:
    known = [outcome for group, outcome in outcomes.items() if not group.rotation_only]
    pooled = {name: [answer for outcome in known for answer in outcome.answers[name]] for name in methods}
    parts = [_paired(outcomes, methods)] if "quest" in methods and len(methods) > 1 else []
    for title, cell in _TABLES.items():
        rows = []
        for group, outcome in outcomes.items():
            label = group.name + (" *" if group.rotation_only else "")
            share = f"{100 * np.median(outcome.true_shares):.0f} %" if outcome.true_shares else "-"
            counts = [str(len(outcome.matches)), f"{np.median(outcome.matches):.0f}", share]
            rows.append([label, *counts, *(cell(outcome.answers[name]) for name in methods)])
        if known:
            rows.append(["all but *", str(sum(len(o.matches) for o in known)), "", "", *map(cell, pooled.values())])
        parts.append(f"**{title}**\n\n" + markdown_table(["pairs of", "pairs", "matches", "true", *methods], rows))
    parts.append(
        "\\* only the rotation is compared: the ground truth does not resolve the direction, or the camera is static."
    )
    return "\n\n".join(parts) + "\n"


def _paired(outcomes: dict[Group, _Outcome], methods: Sequence[str]) -> str:
    """The difference of the AUC of quest and each other method, by data set and over all pairs."""
    sets: dict[str, list[_Outcome]] = {}
    for group, outcome in outcomes.items():
        sets.setdefault(group.name.split(",")[0] + (" *" if group.rotation_only else ""), []).append(outcome)
    sets["all but *"] = [o for group, o in outcomes.items() if not group.rotation_only]
    sets["all"] = list(outcomes.values())
    rows = []
    for name, parts in sets.items():
        ours = _scores(parts, "quest")
        if len(ours) == 0:
            continue
        cells = [_difference(ours - _scores(parts, method)) for method in methods if method != "quest"]
        rows.append([name, str(len(ours)), " / ".join(f"{100 * mean:.1f}" for mean in ours.mean(axis=0)), *cells])
    others = [f"less {method}" for method in methods if method != "quest"]
    title = (
        "quest: AUC at 5 / 10 / 20 deg, %, and what it is above each other method [95 % of the bootstrap over pairs]"
    )
    return f"**{title}**\n\n" + markdown_table(["pairs of", "pairs", "quest", *others], rows)


def _scores(outcomes: Sequence[_Outcome], method: str) -> Floats:
    """What each pair adds to the AUC in the mean of its seeds, (pairs, 3): the mean over the pairs is the AUC."""
    errors = np.array([answer.error_deg for outcome in outcomes for answer in outcome.answers[method]])
    scores = np.clip(1 - errors[:, None] / np.array(_AUC_DEG), 0, 1)
    pairs = sum(len(outcome.matches) for outcome in outcomes)
    return np.asarray(scores.reshape(pairs, -1, len(_AUC_DEG)).mean(axis=1) if pairs else scores)


def _difference(scores: Floats) -> str:
    rng = np.random.default_rng(_SEED)
    means = np.array([scores[rng.integers(len(scores), size=len(scores))].mean(axis=0) for _ in range(_RESAMPLES)])
    low, high = np.percentile(100 * means, [2.5, 97.5], axis=0)
    cells = zip(100 * scores.mean(axis=0), low, high, strict=True)
    return " / ".join(f"{mean:+.1f} [{a:+.1f}, {b:+.1f}]" for mean, a, b in cells)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the methods and print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.real_pairs", allow_abbrev=False)
    parser.description = "Compare robust two-view estimators on pairs of real images below SLAM_INIT_DATA."
    parser.add_argument(
        "--steps",
        type=number_list(int, 1, 10_000),
        default=None,
        metavar="N,M",
        help="by default three by the length of a sequence",
    )
    parser.add_argument("--pairs", type=positive, default=14, metavar="N", help="of a sequence and step (default 14)")
    parser.add_argument("--seeds", type=positive, default=1, metavar="N", help="of each method and pair (default 1)")
    parser.add_argument("--methods", type=choice_list(list(METHODS)), default=list(METHODS), metavar="A,B")
    parser.add_argument("--only", metavar="TEXT", default="", help="only sets whose name contains this text")
    parser.add_argument("--threshold-px", type=float, default=2.0, metavar="X", help="of all methods (default 2)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write real_pairs.md there")
    options = parser.parse_args(argv)
    methods, missing = available(options.methods)
    if missing:
        print(f"not installed, left out: {', '.join(missing)} (pip install '.[bench]')", file=sys.stderr)
    data = data_folder()
    found = [group for group in groups(data, options.steps, options.pairs) if options.only in group.name]
    if not found or not methods:
        print(f"nothing to run on below {data}: set SLAM_INIT_DATA to the folder of real data", file=sys.stderr)
        return 2
    limit_threads()
    warm_up(methods)
    outcomes = {
        group: run_group(group, methods, options.threshold_px, options.seeds) for group in progress(found, "set")
    }
    title = f"SIFT with ratio test, except for the corners; threshold {options.threshold_px:g} px, one thread. All "
    title += f"figures are over the seeds 0 to {options.seeds - 1} of each method."
    save(options.out, "real_pairs.md", f"{title}\n\n{_tables(outcomes, methods)}")
    return 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
