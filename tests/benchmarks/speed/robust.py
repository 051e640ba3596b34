"""Robust estimates: quest and PoseLib on the same matches, one after the other, in CPU time.

The time of an estimate is the least of three. The estimators take turns between the three, so that other load of the
machine meets both. Single runs under load misled. A first run also finds the caches of the processor filled by other
work, such as the matching of images: on real pairs quest then takes 1.4 times as long, PoseLib the same time.

Both get the same threshold. PoseLib has the setting of its makers: 100 iterations at least. The simulated scenes have
given numbers of matches and shares of outliers. The real pairs are those of :mod:`tests.benchmarks.image_pairs`, which
are matched as the pipeline matches photographs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.benchmarks.quest.robust_methods import Floats

#: Matches and outliers of the simulated scenes.
_CASES = ((100, 0.2), (1000, 0.2), (1000, 0.5), (1000, 0.7), (5000, 0.5))
_OURS, _THEIRS = "quest", "PoseLib min 100"
#: Threshold of the simulated scenes in rad, and of the real pairs in pixels, as that of `real_pairs`.
_THRESHOLD_RAD, _THRESHOLD_PX = 4e-3, 2.0
#: Sequences with a ground truth, frames between the images of a pair, and pairs of each.
_SEQUENCES = ("tartanair/hospital_clip", "kitti/06_start", "tsukuba/new_tsukuba_150")
_STEPS, _PAIRS = (1, 5, 10), 12
#: Estimates of the same matches with the same seed, of which the fastest counts.
_TURNS = 3
#: A pair with fewer matches is left out: quest refuses it.
_LEAST_MATCHES = 10


def robust_table(repetitions: int, data: Path) -> str:
    """Measure both estimators.

    * Returns: In markdown; a line that states what is missing where PoseLib is not installed.
    """
    from importlib.util import find_spec

    if find_spec("poselib") is None:
        return "PoseLib is not installed: pip install '.[poselib]'"
    from tests.benchmarks.quest.robust_trials import warm_up

    warm_up([_OURS, _THEIRS])
    cases = {
        f"{matches}, {outliers:.0%}": _times(_drawn(matches, outliers, repetitions)) for matches, outliers in _CASES
    }
    absent = []
    for name in _SEQUENCES:
        if (data / name).is_dir():
            cases[f"{name}, real pairs"] = _times(_real(data / name))
        else:
            absent.append(name)
    real = [times for name, times in cases.items() if name.endswith("real pairs")]
    if real:
        cases["all real pairs"] = {name: [one for times in real for one in times[name]] for name in (_OURS, _THEIRS)}
    message = (
        f"\n\nCPU time, the fastest of {_TURNS} turns of each estimate, after a warm-up; quest and PoseLib alternate."
    )
    message += " PoseLib runs at least 100 iterations, as its makers advise."
    message += f" Left out, because the folder of data does not hold them: {', '.join(absent)}." if absent else ""
    return estimates_table(cases) + message


def estimates_table(cases: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """The table of the estimates.

    * ``cases``: Times in milliseconds by case and estimator: first that of this project, then the other.
    * Returns: In markdown. The ratios are those of the medians and of the 99th percentiles.
    """
    import numpy as np

    from tests.benchmarks.tables import markdown_table, number

    rows = []
    for case, of_estimator in cases.items():
        ours, theirs = (np.percentile(times, (50, 99)) if len(times) else None for times in of_estimator.values())
        count = len(next(iter(of_estimator.values())))
        if ours is None or theirs is None:
            rows.append([case, "0", *["-"] * 6])
            continue
        figures = [number(float(one), 2) for one in (*ours, *theirs, *(ours / theirs))]
        rows.append([case, str(count), *figures])
    header = [
        "matches, outliers", "pairs", "quest: median (ms)", "99th percentile", "PoseLib: median (ms)",
        "99th percentile", "ratio of medians", "of 99th percentiles",
    ]  # fmt: skip
    return markdown_table(header, rows)


def _times(pairs: Iterator[tuple[Floats, Floats, float, int]]) -> dict[str, list[float]]:
    """Least CPU time of each estimator on each pair, in milliseconds."""
    from tests.benchmarks.quest.robust_methods import METHODS

    times: dict[str, list[float]] = {_OURS: [], _THEIRS: []}
    for bearings1, bearings2, threshold_rad, seed in pairs:
        turns = [
            [METHODS[name][1](bearings1, bearings2, threshold_rad, seed).seconds for name in times]
            for _ in range(_TURNS)
        ]
        for found, *seconds in zip(times.values(), *turns, strict=True):
            found.append(1e3 * min(seconds))
    return times


def _drawn(matches: int, outliers: float, repetitions: int) -> Iterator[tuple[Floats, Floats, float, int]]:
    import numpy as np

    from tests.benchmarks.quest.scenes import SCENES, draw_scene

    for seed in range(repetitions):
        rng = np.random.default_rng((7, seed))
        scene = draw_scene(SCENES["general .15"], rng, matches=matches, outlier_share=outliers, noise_px=0.7)
        yield scene.bearings1, scene.bearings2, _THRESHOLD_RAD, seed


def _real(folder: Path) -> Iterator[tuple[Floats, Floats, float, int]]:
    from slam_init.datasets import open_source
    from tests.benchmarks.image_pairs import sequence_pairs

    source = open_source(str(folder))
    for step in _STEPS:
        for pair in sequence_pairs(source, step, _PAIRS) if step < len(source) else ():
            if len(pair.bearings1) >= _LEAST_MATCHES:
                yield pair.bearings1, pair.bearings2, _THRESHOLD_PX / pair.focal_px, 0
