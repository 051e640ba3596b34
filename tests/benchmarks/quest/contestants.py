"""The solvers of the comparison: those of this package, the printed forms, and OpenCV and PoseLib if installed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from quest.paper.printed import quest6_printed, quest7_printed
from quest.paper.quest6 import quest6
from tests.benchmarks.quest.baselines.essential import rotations_of_essential
from tests.benchmarks.quest.solvers import SOLVERS

Floats = NDArray[np.float64]
Solve = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Contestant:
    """A solver of batches: bearings (B, points, 3) twice, to quaternions (B, K, 4) padded with NaN."""

    name: str
    points: int
    solve: Solve


def contestants() -> list[Contestant]:
    """All solvers of the comparison, in the order of the tables."""
    chosen = [
        Contestant("QuEst 6 printed", 6, one_by_one(quest6_printed)),
        Contestant("QuEst 7 printed", 7, one_by_one(quest7_printed)),
        Contestant("QuEst 6, x alone", 6, lambda m, n: quest6(m, n, lambdas="x")),
    ]
    for solver in SOLVERS.values():
        chosen.append(Contestant(solver.name, solver.sample_size, solver.function))
        if solver.name in ("QuEst N", "homography"):
            chosen.append(Contestant(f"{solver.name}, 8 points", 8, solver.function))
    if find_spec("cv2"):
        chosen.append(Contestant("5-point of OpenCV", 5, one_by_one(_opencv_five_point)))
    if find_spec("poselib"):
        chosen.append(Contestant("5-point of PoseLib", 5, one_by_one(_poselib_five_point)))
    return chosen


def one_by_one(solve: Solve) -> Solve:
    """Make a solver of batches from a solver of one sample."""

    def solve_all(m: Floats, n: Floats) -> Floats:
        found = [solve(*sample) for sample in zip(m, n, strict=True)]
        padded = np.full((len(found), max(1, *map(len, found)), 4), np.nan)
        for row, q in zip(padded, found, strict=True):
            row[: len(q)] = q
        return padded

    return solve_all


def _opencv_five_point(m: Floats, n: Floats) -> Floats:
    """``findEssentialMat`` of exactly five points returns all essential matrices, one below the other."""
    import cv2

    E, _ = cv2.findEssentialMat(m[:, :2] / m[:, 2:], n[:, :2] / n[:, 2:], np.eye(3))
    if E is None:
        return np.empty((0, 4))
    return rotations_of_essential(np.asarray(E, float).reshape(-1, 3, 3)).reshape(-1, 4)


def _poselib_five_point(m: Floats, n: Floats) -> Floats:
    """The poses of PoseLib, with all five points in front of both cameras."""
    import poselib

    return np.array([pose.q for pose in poselib.relpose_5pt(m, n)], float).reshape(-1, 4)
