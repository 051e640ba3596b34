"""Coverage of the covariance of :func:`quest.estimate_relative_pose`: ``python -m tests.benchmarks.quest.coverage``.

A cell is a scene, a share of outliers and a number of matches. Its figures: the share of the poses whose error over the
five unknowns lies within the 95 % ellipsoid of the stated covariance; the median of the squared normalized error
divided by that of chi-square; the number of poses. Answers without a translation are left out. Where a plane allows two
poses, the nearer one is compared only if it is the first: the covariance is that of the first.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quest import RelativePose, estimate_relative_pose
from quest.geometry.epipolar import tangent_basis
from quest.geometry.quaternion import vector_from_rotation
from tests.benchmarks.options import positive, run_on_one_thread, save
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene
from tests.benchmarks.tables import markdown_table

#: The 95 % point and the median of chi-square with five degrees of freedom.
_BOUND, _MEDIAN = 11.0705, 4.3515
_SCENES = ("general .15", "general .03", "plane .15", "forward .15", "low parallax .01")
_OUTLIERS, _MATCHES = (0.0, 0.3, 0.6), (100, 500)
_NOISE_PX, _THRESHOLD_PX = 0.7, 2.0


def normalized_error(pose: RelativePose, R: NDArray[np.float64], t: NDArray[np.float64]) -> float:
    """Squared error of a pose over its five unknowns in units of its covariance; infinite for an opposite direction."""
    along = float(pose.t @ t)
    if along <= 0:
        return float("inf")
    error = np.concatenate([vector_from_rotation(R @ pose.R.T), tangent_basis(pose.t).T @ t / along])
    return float(error @ np.linalg.solve(pose.covariance, error))


def errors_of_cell(name: str, outliers: float, matches: int, trials: int) -> tuple[NDArray[np.float64], float]:
    """Normalized errors of the poses of a cell, and the share of these poses that state that the covariance holds."""
    errors, stated = [], []
    for seed in range(trials):
        rng = np.random.default_rng((41, seed, int(10 * outliers), matches))
        scene = draw_scene(SCENES[name], rng, matches=matches, outlier_share=outliers, noise_px=_NOISE_PX)
        pose = estimate_relative_pose(
            scene.bearings1, scene.bearings2, threshold_rad=_THRESHOLD_PX / FOCAL_PX, seed=seed
        )
        if isinstance(pose, RelativePose) and pose.kind != "rotation" and not _alternative_is_nearer(pose, scene):
            errors.append(normalized_error(pose, scene.R, scene.t))
            stated.append(pose.covariance_holds)
    return np.array(errors), float(np.mean(stated)) if stated else 0.0


def _alternative_is_nearer(pose: RelativePose, scene: Scene) -> bool:
    return any(other.t @ scene.t > pose.t @ scene.t for other in pose.alternatives)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, and write it to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.coverage", allow_abbrev=False)
    parser.add_argument("--trials", type=positive, default=100, help="scenes a cell (default 100)")
    parser.add_argument("--out", type=Path, help="folder for coverage.md")
    options = parser.parse_args(argv)
    rows = []
    for name in _SCENES:
        for outliers in _OUTLIERS:
            cells = [name, f"{outliers:.0%}"]
            for matches in _MATCHES:
                errors, stated = errors_of_cell(name, outliers, matches, options.trials)
                if len(errors) == 0:
                    cells.append("-")
                    continue
                covered, median = 100 * np.mean(errors < _BOUND), np.median(errors) / _MEDIAN
                mark = "" if stated > 0.5 else " *"
                cells.append(f"{covered:.0f} / {median:.2f} / {len(errors)}{mark}")
            rows.append(cells)
    header = ["scene", "outliers", *(f"{matches} matches" for matches in _MATCHES)]
    title = f"{options.trials} scenes a cell, {_NOISE_PX} px: coverage at 95 % / median over expected / poses. "
    title += "\\*: most poses state that the covariance may not hold (`covariance_holds` is false).\n\n"
    save(options.out, "coverage.md", title + markdown_table(header, rows) + "\n")


if __name__ == "__main__":
    run_on_one_thread()
    main()
