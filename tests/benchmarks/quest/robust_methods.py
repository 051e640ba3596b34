"""Robust two-view estimators with one interface, quest and PoseLib, and their answers beside the truth.

Both get the same matched bearings and the same threshold. PoseLib gets the bearings as points of a pinhole camera with
``_FOCAL_PX``; its other options are the defaults or the recommendations of its authors. The measured time is the
processor time of the call of the estimator, without the conversion of the matches. On one thread of an idle machine it
equals the wall time, and on a busy machine it does not change.

PoseLib returns one pose. It does not report whether the camera is rotation-only, or whether a second pose explains a
plane.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.estimate import NoPose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, draw_scene

Floats = NDArray[np.float64]

#: Focal length of the camera for PoseLib; it cancels against the threshold in pixels.
_FOCAL_PX = 500.0
#: A pose with smaller errors counts as the true pose: the two poses of a plane are farther apart, and a bundle
#: adjustment converges from it.
FOUND_DEG = 5.0
#: Threshold of all methods, and the bounds of the AUC.
THRESHOLD_PX, AUC_DEG = 2.0, (5.0, 10.0, 20.0)
#: Smallest number of matches that quest accepts.
MIN_MATCHES = 10


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer of an estimator."""

    #: (R, t) ``cam2_from_cam1``, the best first, then the other returned poses; t is zero for a rotation-only camera.
    #: Empty without a pose.
    poses: tuple[tuple[Floats, Floats], ...] = ()
    #: Processor time of the call.
    seconds: float = 0.0


Method = Callable[[Floats, Floats, float, int], Estimate]
"""``(bearings1, bearings2, threshold_rad, seed) -> Estimate``."""


def _quest(bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int) -> Estimate:
    begin = time.process_time()
    found = estimate_relative_pose(bearings1, bearings2, threshold_rad=threshold_rad, seed=seed)
    seconds = time.process_time() - begin
    if isinstance(found, NoPose):
        return Estimate((), seconds)
    # The pose and at most one alternative are compared: with more poses a chance hit would count.
    return Estimate(((found.R, found.t), *((other.R, other.t) for other in found.alternatives[:1])), seconds)


def _poselib(
    options: dict[str, Any], bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int
) -> Estimate:
    from slam_init.methods.poselib import relative_pose_of_poselib

    camera = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [_FOCAL_PX, 0.0, 0.0]}
    x1, x2 = (np.ascontiguousarray(_FOCAL_PX * rays[:, :2] / rays[:, 2:]) for rays in (bearings1, bearings2))
    begin = time.process_time()
    pose, info = relative_pose_of_poselib(x1, x2, camera, threshold_rad * _FOCAL_PX, {"seed": seed, **options})
    seconds = time.process_time() - begin
    return Estimate(((np.array(pose.R), np.array(pose.t)),) if info["num_inliers"] else (), seconds)


_ALL: dict[str, Method] = {
    "quest": _quest,
    "PoseLib": partial(_poselib, {}),
    "PoseLib min 100": partial(_poselib, {"min_iterations": 100}),
}
#: The methods that are installed. The default of PoseLib is at least 1000 samples; where most matches are inliers it
#: needs a tenth of that number.
METHODS = {name: method for name, method in _ALL.items() if name == "quest" or find_spec("poselib")}


@dataclass(frozen=True)
class Answer:
    """The answer of a method, compared with the truth."""

    #: The larger of the errors of rotation and direction: of the first pose, and of the best of the returned poses.
    #: Infinite without a pose, and where the pose or the truth has no translation.
    error_deg: float
    kept_error_deg: float
    #: Number of returned poses.
    kept: int
    time_ms: float


def answer(estimate: Estimate, R: Floats, t: Floats, *, rotation_only: bool = False) -> Answer:
    """Compare an estimate with the true pose R (3, 3), t (3,).

    With ``rotation_only`` the directions are not compared, since the true direction is unknown.
    """
    errors = [max(pose_errors_deg(*pose, R, t)[: 1 if rotation_only else 2]) for pose in estimate.poses]
    errors = errors or [float("inf")]
    return Answer(errors[0], min(errors), len(estimate.poses), 1e3 * estimate.seconds)


def pose_errors_deg(R: Floats, t: Floats, true_R: Floats, true_t: Floats) -> tuple[float, float]:
    """Angles in degrees between two rotations (3, 3), and between two translations (3,) of any norm.

    The sign of t is included: backward motion in place of forward motion is an error of 180 degrees. Where either
    translation is zero there is no direction, and the angle is infinite.
    """
    rotation = float(np.rad2deg(rotation_angle(R @ true_R.T)))
    if not (np.any(t) and np.any(true_t)):
        return rotation, float("inf")
    return rotation, float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(t, true_t)), t @ true_t)))


def warm_up(methods: Sequence[str]) -> None:
    """Make the first calls of each method, which may load or compile, so that they are not measured."""
    for name, method in product(("general .15", "plane .15", "rotation"), methods):
        scene = draw_scene(SCENES[name], np.random.default_rng(0), matches=100, outlier_share=0.1, noise_px=0.5)
        METHODS[method](scene.bearings1, scene.bearings2, THRESHOLD_PX / FOCAL_PX, 0)


def share_below(errors_deg: ArrayLike, bound_deg: float = FOUND_DEG) -> float:
    """Percentage of errors below a bound; infinity and NaN are not below it."""
    return 100 * float(np.mean(np.asarray(errors_deg) < bound_deg))


def area_scores(errors_deg: ArrayLike) -> Floats:
    """What each error (N,) adds to the areas under the curve of recall over error up to the bounds, (N, 3).

    The curve is that of the share of errors of at most e (P.-E. Sarlin et al., "SuperGlue", CVPR 2020), as a staircase;
    the area (AUC) is the mean over the errors.
    """
    return np.asarray(np.clip(1 - np.asarray(errors_deg, float)[:, None] / np.array(AUC_DEG), 0, 1))


def area_cell(errors_deg: ArrayLike) -> str:
    """AUC at 5 / 10 / 20 deg in per cent."""
    return " / ".join(f"{100 * area:.0f}" for area in area_scores(errors_deg).mean(axis=0))
