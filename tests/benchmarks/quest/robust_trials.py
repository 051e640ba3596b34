"""Trials of the robust comparison: the scenes, and the answers of each method."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quest.geometry.refine import refine_pose
from tests.benchmarks.quest.measures import pose_errors_deg
from tests.benchmarks.quest.robust_methods import METHODS, Estimate
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """Conditions of a trial: key of :data:`SCENES`, share of outliers, noise in pixels, number of matches."""

    scene: str
    outlier_share: float
    noise_px: float
    matches: int


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The answer of a method, compared with the truth."""

    method: str
    #: See :class:`tests.benchmarks.quest.robust_methods.Estimate`.
    kind: str
    #: Number of returned poses.
    kept: int
    #: rotation_error_deg, direction_error_deg: Errors of the first pose; infinite without a pose. The error of the
    #: direction is infinite too where the pose or the truth has no translation, and NaN where the true direction is
    #: unknown.
    rotation_error_deg: float
    direction_error_deg: float
    #: The larger of the two errors, of the best of the returned poses.
    kept_error_deg: float
    time_ms: float

    @property
    def error_deg(self) -> float:
        """The larger of the known errors of the first pose."""
        return float(np.fmax(self.rotation_error_deg, self.direction_error_deg))


@dataclass(frozen=True, kw_only=True)
class Trial(Answer):
    """An answer on a scene."""

    #: scene, outlier_share, noise_px, matches: See :class:`Cell`.
    scene: str
    outlier_share: float
    noise_px: float
    matches: int
    #: Number of the trial; the same scene for all methods, and the same geometry at all shares of outliers.
    seed: int
    #: Error of a refinement from the truth on the true inliers: the smallest error that the data allow.
    oracle_error_deg: float


def star_grid(
    scenes: Sequence[str], outliers: Sequence[float], noises: Sequence[float], matches: Sequence[int]
) -> list[Cell]:
    """One factor varies at a time; the others have the middle value of their list."""
    outlier, noise = outliers[len(outliers) // 2], noises[len(noises) // 2]
    count = matches[len(matches) // 2]
    cells = [
        *(Cell(scene, o, noise, count) for scene in scenes for o in outliers),
        *(Cell(scene, outlier, n, count) for scene in scenes for n in noises),
        *(Cell(scene, outlier, noise, c) for scene in scenes for c in matches),
    ]
    return list(dict.fromkeys(cells))


def full_grid(
    scenes: Sequence[str], outliers: Sequence[float], noises: Sequence[float], matches: Sequence[int]
) -> list[Cell]:
    """Every combination."""
    return [Cell(*values) for values in product(scenes, outliers, noises, matches)]


def warm_up(methods: Sequence[str]) -> None:
    """Make the first calls of each method, which may load or compile, so that they are not measured."""
    for name, method in product(("general .15", "plane .15", "rotation"), methods):
        scene = draw_scene(SCENES[name], np.random.default_rng(0), matches=100, outlier_share=0.1, noise_px=0.5)
        _run(method, scene, 2 / FOCAL_PX, 0)


def run_trials(
    cells: Sequence[Cell], methods: Sequence[str], trials: int, *, threshold_px: float, seed: int
) -> Iterator[Trial]:
    """Run all methods on each scene in turn, so that other load of the machine affects all methods equally.

    Call :func:`warm_up` before if the times matter.
    """
    for cell, k in product(cells, range(trials)):
        rng = np.random.default_rng([seed, list(SCENES).index(cell.scene), k])
        scene = draw_scene(
            SCENES[cell.scene],
            rng,
            matches=cell.matches,
            outlier_share=cell.outlier_share,
            noise_px=cell.noise_px,
        )
        oracle = oracle_error_deg(scene, cell.noise_px / FOCAL_PX)
        for method in methods:
            answer = judge(method, _run(method, scene, threshold_px / FOCAL_PX, k), scene.R, scene.t)
            yield Trial(**asdict(cell), **asdict(answer), seed=k, oracle_error_deg=oracle)


def _run(method: str, scene: Scene, threshold_rad: float, seed: int) -> Estimate:
    return METHODS[method][1](scene.bearings1, scene.bearings2, threshold_rad, seed)


def judge(method: str, estimate: Estimate, R: Floats, t: Floats, *, rotation_only: bool = False) -> Answer:
    """Compare an estimate with the true pose R (3, 3), t (3,).

    With ``rotation_only`` the directions are not compared, since the true direction is unknown.
    """
    errors = [pose_errors_deg(*pose, R, t) for pose in estimate.poses] or [(float("inf"), float("inf"))]
    if rotation_only:
        errors = [(rotation, float("nan")) for rotation, _ in errors]
    return Answer(
        method=method,
        kind=estimate.kind,
        kept=len(estimate.poses),
        rotation_error_deg=errors[0][0],
        direction_error_deg=errors[0][1],
        kept_error_deg=min(float(np.fmax(*pair)) for pair in errors),
        time_ms=1e3 * estimate.seconds,
    )


def oracle_error_deg(scene: Scene, noise_rad: float) -> float:
    """Error of a refinement from the true pose on the true inliers; infinite where there is no true translation."""
    if not np.any(scene.t):
        return float("inf")
    m, n = scene.bearings1[scene.inliers], scene.bearings2[scene.inliers]
    # With Gaussian noise a kernel of three deviations is nearly least squares.
    R, t = refine_pose(scene.R, scene.t, m, n, max(3 * noise_rad, 1e-6))
    return max(pose_errors_deg(R, t, scene.R, scene.t))


def write_csv(trials: Sequence[Trial], path: Path) -> None:
    """Write one row for each trial, so that other tables can be made from the same run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Trial)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(trial) for trial in trials)
