"""Robust two-view estimators on real images: ``python -m tests.benchmarks.real_pairs --out FILE``.

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

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_init.datasets import open_source
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
from tests.benchmarks.options import data_folder, program, progress, run_on_one_thread, show
from tests.benchmarks.quest.robust_methods import (
    METHODS,
    MIN_MATCHES,
    THRESHOLD_PX,
    Answer,
    Estimate,
    answer,
    area_cell,
    area_scores,
    share_below,
    warm_up,
)
from tests.benchmarks.tables import markdown_table

Floats = NDArray[np.float64]

_CHESSBOARD = "planar/opencv_chessboard"
#: Steps of a sequence of fewer frames: photographs, short clips, videos.
_STEPS = ((25, [1, 2, 3]), (100, [2, 10, 25]), (10**9, [5, 15, 40]))
#: Resamples of the bootstrap, and its seed.
_RESAMPLES, _SEED = 5000, 0


@dataclass(frozen=True, eq=False)
class Group:
    """Pairs that make one row of the tables."""

    name: str
    #: Returns an iterator over the pairs.
    read: Callable[[], Iterator[ImagePair]]
    #: Only the rotation is compared.
    rotation_only: bool


def groups(data: Path, limit: int) -> list[Group]:
    """Return all groups of pairs below a folder of data, with up to ``limit`` pairs of each sequence and step."""
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
            for step in next(steps for most, steps in _STEPS if len(source) < most)
            if step < len(source)
        ]
    return found


@dataclass(frozen=True, eq=False)
class _Outcome:
    """The answers of each method come pair by pair, with all seeds of a pair together."""

    matches: list[int]
    true_shares: list[float]
    answers: dict[str, list[Answer]]


def run_group(group: Group, seeds: int) -> _Outcome:
    """Run all methods on all pairs of a group, with each seed; too few matches are a failure of all methods."""
    outcome = _Outcome([], [], {name: [] for name in METHODS})
    for pair in group.read():
        rays, threshold_rad = (pair.bearings1, pair.bearings2), THRESHOLD_PX / pair.focal_px
        outcome.matches.append(len(pair.bearings1))
        enough = len(pair.bearings1) >= MIN_MATCHES
        if enough:
            outcome.true_shares.append(float(true_matches(pair, *rays, threshold_rad).mean()))
        pose = pair.cam2_from_cam1
        for name, method in METHODS.items():
            for seed in range(seeds):
                estimate = method(*rays, threshold_rad, seed) if enough else Estimate()
                outcome.answers[name].append(answer(estimate, pose.R, pose.t, rotation_only=group.rotation_only))
    return outcome


def _errors(answers: Sequence[Answer]) -> list[float]:
    return [one.error_deg for one in answers]


def _area(answers: Sequence[Answer]) -> str:
    return area_cell(_errors(answers))


def _kept(answers: Sequence[Answer]) -> str:
    if not answers:
        return "-"
    share = share_below([one.kept_error_deg for one in answers])
    return f"{share:.0f} ({np.mean([one.kept for one in answers]):.2f})"


_TABLES: dict[str, Callable[[Sequence[Answer]], str]] = {
    "AUC at 5 / 10 / 20 deg, %": _area,
    "Truth within 5 deg among the poses kept, % (number of poses kept)": _kept,
}


def _tables(outcomes: dict[Group, _Outcome]) -> str:
    known = [outcome for group, outcome in outcomes.items() if not group.rotation_only]
    parts = [_paired(outcomes)]
    for title, cell in _TABLES.items():
        rows = []
        for group, outcome in outcomes.items():
            label = group.name + (" *" if group.rotation_only else "")
            share = f"{100 * np.median(outcome.true_shares):.0f} %" if outcome.true_shares else "-"
            counts = [str(len(outcome.matches)), f"{np.median(outcome.matches):.0f}", share]
            rows.append([label, *counts, *map(cell, outcome.answers.values())])
        pooled = [[one for outcome in known for one in outcome.answers[name]] for name in METHODS]
        if known:
            rows.append(["all but *", str(sum(len(o.matches) for o in known)), "", "", *map(cell, pooled)])
        parts.append(f"**{title}**\n\n" + markdown_table(["pairs of", "pairs", "matches", "true", *METHODS], rows))
    parts.append(
        "\\* only the rotation is compared: the ground truth does not resolve the direction, or the camera is static."
    )
    return "\n\n".join(parts) + "\n"


def _paired(outcomes: dict[Group, _Outcome]) -> str:
    """The difference of the AUC of quest and each other method, by data set and over all pairs."""
    sets: dict[str, list[_Outcome]] = {}
    for group, outcome in outcomes.items():
        sets.setdefault(group.name.split(",")[0] + (" *" if group.rotation_only else ""), []).append(outcome)
    sets["all but *"] = [o for group, o in outcomes.items() if not group.rotation_only]
    sets["all"] = list(outcomes.values())
    rows, others = [], [method for method in METHODS if method != "quest"]
    for name, parts in sets.items():
        ours = _scores(parts, "quest")
        if len(ours) == 0:
            continue
        cells = [_difference(ours - _scores(parts, method)) for method in others]
        rows.append([name, str(len(ours)), " / ".join(f"{100 * mean:.1f}" for mean in ours.mean(axis=0)), *cells])
    title = (
        "quest: AUC at 5 / 10 / 20 deg, %, and what it is above each other method [95 % of the bootstrap over pairs]"
    )
    return f"**{title}**\n\n" + markdown_table(
        ["pairs of", "pairs", "quest", *(f"less {method}" for method in others)], rows
    )


def _scores(outcomes: Sequence[_Outcome], method: str) -> Floats:
    """What each pair adds to the AUC in the mean of its seeds, (pairs, 3): the mean over the pairs is the AUC."""
    scores = area_scores([error for outcome in outcomes for error in _errors(outcome.answers[method])])
    pairs = sum(len(outcome.matches) for outcome in outcomes)
    return np.asarray(scores.reshape(pairs, -1, 3).mean(axis=1) if pairs else scores)


def _difference(scores: Floats) -> str:
    rng = np.random.default_rng(_SEED)
    means = np.array([scores[rng.integers(len(scores), size=len(scores))].mean(axis=0) for _ in range(_RESAMPLES)])
    low, high = np.percentile(100 * means, [2.5, 97.5], axis=0)
    cells = zip(100 * scores.mean(axis=0), low, high, strict=True)
    return " / ".join(f"{mean:+.1f} [{a:+.1f}, {b:+.1f}]" for mean, a, b in cells)


def main() -> int:
    """Run the methods and print the tables; return the exit code."""
    parser = program("real_pairs", __doc__)
    parser.add_argument("--pairs", type=int, default=14, metavar="N", help="of a sequence and step (default 14)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="of each method and pair (default 1)")
    parser.add_argument("--only", metavar="TEXT", default="", help="only sets whose name contains this text")
    options = parser.parse_args()
    found = [group for group in groups(data_folder(), options.pairs) if options.only in group.name]
    if not found:
        print(
            f"nothing to run on below {data_folder()}: set SLAM_INIT_DATA to the folder of real data", file=sys.stderr
        )
        return 2
    warm_up(list(METHODS))
    outcomes = {group: run_group(group, options.seeds) for group in progress(found, "set")}
    title = f"SIFT with ratio test, except for the corners; threshold {THRESHOLD_PX:g} px, one thread. All "
    title += f"figures are over the seeds 0 to {options.seeds - 1} of each method."
    show(f"{title}\n\n{_tables(outcomes)}", options.out)
    return 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
