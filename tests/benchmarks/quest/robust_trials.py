"""The answers of robust methods, beside the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.quest.measures import pose_errors_deg
from tests.benchmarks.quest.reference import refine_pose
from tests.benchmarks.quest.robust_methods import METHODS, Estimate
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene

Floats = NDArray[np.float64]


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


def warm_up(methods: Sequence[str]) -> None:
    """Make the first calls of each method, which may load or compile, so that they are not measured."""
    for name, method in product(("general .15", "plane .15", "rotation"), methods):
        scene = draw_scene(SCENES[name], np.random.default_rng(0), matches=100, outlier_share=0.1, noise_px=0.5)
        _run(method, scene, 2 / FOCAL_PX, 0)


def _run(method: str, scene: Scene, threshold_rad: float, seed: int) -> Estimate:
    return METHODS[method][1](scene.bearings1, scene.bearings2, threshold_rad, seed)


def evaluate(method: str, estimate: Estimate, R: Floats, t: Floats, *, rotation_only: bool = False) -> Answer:
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
