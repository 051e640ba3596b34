"""Robust two-view estimators side by side: ours and those of OpenCV, PoseLib and COLMAP.

All get the same matched bearings and the same threshold; the others get them as points of a pinhole camera with
``_FOCAL_PX``. Beyond the threshold each has the options that its makers give as defaults or recommend. Only the call of
the estimator is timed, converting the matches is not, and it is the processor's time that is taken: on one thread of an
idle machine that is the wall clock's, and on a busy one it is still right.

OpenCV and PoseLib answer with one pose and know no other verdict: whether the camera turned without moving, or whether
a second pose explains a plane, is left to their caller. pycolmap tells a panoramic pair from a planar one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["METHODS", "Estimate", "Method", "available", "limit_threads"]

Floats = NDArray[np.float64]

#: Of the camera that the others see; it cancels against the threshold in pixels.
_FOCAL_PX = 500.0
#: Confidence and bound of the sampling for OpenCV, whose default of 1000 samples ends before an outlier share of 70 %.
#: The confidence is that of quest, the bound PoseLib's.
_CONFIDENCE, _MAX_SAMPLES = 0.999, 100_000
#: OpenCV leaves out points farther than so many baselines before it votes on the pose, by default 50: with a baseline
#: of .01 of the depth that would be all of them.
_FARTHEST_BASELINES = 1e6


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator answered.

    Attributes
    ----------
    poses : tuple of (R, t)
        ``cam2_from_cam1``, the best first, then what it keeps beside it; t is zero where it says that the camera only
        turned. Empty where it found none.
    seconds : float
        Processor time of the call.
    kind : str
        "general", "planar" or "rotation" as the estimator says; "general" where it cannot say; "none" without a pose.
    """

    poses: tuple[tuple[Floats, Floats], ...]
    seconds: float
    kind: str


Method = Callable[[Floats, Floats, float, int], Estimate]
"""``(bearings1, bearings2, threshold_rad, seed) -> Estimate``."""


def limit_threads() -> None:
    """Run OpenCV on one thread; the numerical libraries are told before they are loaded."""
    if find_spec("cv2"):
        import cv2

        cv2.setNumThreads(1)


def _quest(bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int) -> Estimate:
    from quest.estimate import NoPose, estimate_relative_pose

    begin = time.process_time()
    found = estimate_relative_pose(bearings1, bearings2, threshold_rad=threshold_rad, seed=seed)
    seconds = time.process_time() - begin
    if isinstance(found, NoPose):
        return Estimate((), seconds, "none")
    # The pose and at most one alternative are compared: more would be a list of guesses.
    kept = [(found.R, found.t), *((other.R, other.t) for other in found.alternatives[:1])]
    return Estimate(tuple(kept), seconds, found.kind)


def _opencv(flag: str, bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int) -> Estimate:
    """``findEssentialMat`` with one of its USAC presets, then ``recoverPose``. Its seed is fixed."""
    import cv2

    x1, x2 = _points(bearings1), _points(bearings2)
    K = np.diag([_FOCAL_PX, _FOCAL_PX, 1.0])
    begin = time.process_time()
    try:
        E, mask = cv2.findEssentialMat(
            x1, x2, K, getattr(cv2, flag), _CONFIDENCE, threshold_rad * _FOCAL_PX, _MAX_SAMPLES
        )
        if E is None or E.shape != (3, 3):
            return Estimate((), time.process_time() - begin, "none")
        _, R, t, _, _ = cv2.recoverPose(E, x1, x2, K, distanceThresh=_FARTHEST_BASELINES, mask=mask)
    except cv2.error:  # raised where no sample gave a model: its way to say that there is no pose
        return Estimate((), time.process_time() - begin, "none")
    seconds = time.process_time() - begin
    return Estimate(((np.asarray(R, float), np.asarray(t, float).ravel()),), seconds, "general")


def _poselib(
    options: dict[str, Any], bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int
) -> Estimate:
    import poselib

    camera = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [_FOCAL_PX, 0.0, 0.0]}
    x1, x2 = _points(bearings1), _points(bearings2)
    ransac = {"max_epipolar_error": threshold_rad * _FOCAL_PX, "seed": seed, **options}
    begin = time.process_time()
    pose, info = poselib.estimate_relative_pose(x1, x2, camera, camera, ransac)
    seconds = time.process_time() - begin
    if info["num_inliers"] == 0:
        return Estimate((), seconds, "none")
    return Estimate(((np.array(pose.R), np.array(pose.t)),), seconds, "general")


def _pycolmap(bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int) -> Estimate:
    """The estimator behind COLMAP's geometric verification: E, F and H, of which it chooses by counts of inliers."""
    import pycolmap

    x1, x2 = _points(bearings1), _points(bearings2)
    # Its check for watermarks looks at the border of the image, so that there must be one around the points.
    half = float(np.ceil(1.25 * max(np.abs(x1).max(), np.abs(x2).max())))
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=int(2 * half), height=int(2 * half), params=[_FOCAL_PX, half, half]
    )
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
    options.ransac.max_error = threshold_rad * _FOCAL_PX
    options.ransac.random_seed = seed
    index = np.arange(len(x1), dtype=np.uint32)
    matches = np.column_stack([index, index])
    begin = time.process_time()
    found = pycolmap.estimate_calibrated_two_view_geometry(camera, x1 + half, camera, x2 + half, matches, options)
    seconds = time.process_time() - begin
    pose, name = found.cam2_from_cam1, pycolmap.TwoViewGeometryConfiguration(found.config).name
    if pose is None or name in ("UNDEFINED", "DEGENERATE", "WATERMARK"):
        return Estimate((), seconds, "none")
    R, t = pose.rotation.matrix(), np.array(pose.translation)
    if name == "PANORAMIC":
        return Estimate(((R, np.zeros(3)),), seconds, "rotation")
    return Estimate(((R, t),), seconds, "planar" if name.startswith("PLANAR") else "general")


def _points(bearings: Floats) -> Floats:
    """Points (N, 2) in the image of the camera that the others see."""
    return np.ascontiguousarray(_FOCAL_PX * bearings[:, :2] / bearings[:, 2:])


#: Name -> package that it needs, and the method. PoseLib's default is 1000 samples at least; where most matches are
#: inliers it needs a tenth of them.
METHODS: dict[str, tuple[str, Method]] = {
    "quest": ("quest", _quest),
    "OpenCV MAGSAC": ("cv2", partial(_opencv, "USAC_MAGSAC")),
    "OpenCV ACCURATE": ("cv2", partial(_opencv, "USAC_ACCURATE")),
    "PoseLib": ("poselib", partial(_poselib, {})),
    "PoseLib min 100": ("poselib", partial(_poselib, {"min_iterations": 100})),
    "pycolmap": ("pycolmap", _pycolmap),
}


def available(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Of the names of methods, those whose package is installed, and those whose package is not."""
    here = [name for name in names if find_spec(METHODS[name][0])]
    return here, [name for name in names if name not in here]
