"""Robust two-view estimators with one interface: quest, OpenCV, PoseLib and COLMAP.

All get the same matched bearings and the same threshold. The others than quest get the bearings as points of a pinhole
camera with ``_FOCAL_PX``. The other options of each are the defaults or the recommendations of its authors. The
measured time is the processor time of the call of the estimator, without the conversion of the matches. On one thread
of an idle machine it equals the wall time, and on a busy machine it does not change.

OpenCV and PoseLib return one pose. They do not report whether the camera is rotation-only, or whether a second pose
explains a plane. pycolmap distinguishes panoramic pairs from planar ones.
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

Floats = NDArray[np.float64]

#: Focal length of the camera for the others; it cancels against the threshold in pixels.
_FOCAL_PX = 500.0
#: Confidence and bound of the sampling for OpenCV, whose default of 1000 samples ends before an outlier share of 70 %.
#: The confidence is that of quest, the bound PoseLib's.
_CONFIDENCE, _MAX_SAMPLES = 0.999, 100_000
#: OpenCV ignores points farther than this number of baselines where it chooses the pose, by default 50. With a baseline
#: of .01 of the depth it would ignore all points.
_FARTHEST_BASELINES = 1e6


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer of an estimator."""

    #: (R, t) ``cam2_from_cam1``, the best first, then the other returned poses; t is zero for a rotation-only camera.
    #: Empty without a pose.
    poses: tuple[tuple[Floats, Floats], ...]
    #: Processor time of the call.
    seconds: float
    #: "general", "planar" or "rotation" as the estimator reports; "general" if it reports no kind; "none" without a
    #: pose.
    kind: str


Method = Callable[[Floats, Floats, float, int], Estimate]
"""``(bearings1, bearings2, threshold_rad, seed) -> Estimate``."""


def limit_threads() -> None:
    """Run OpenCV on one thread; :func:`tests.benchmarks.options.run_on_one_thread` limits the other libraries."""
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
    # The pose and at most one alternative are compared: with more poses a chance hit would count.
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
    except cv2.error:  # raised where no sample gave a model: no pose
        return Estimate((), time.process_time() - begin, "none")
    seconds = time.process_time() - begin
    return Estimate(((np.asarray(R, float), np.asarray(t, float).ravel()),), seconds, "general")


def _poselib(
    options: dict[str, Any], bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int
) -> Estimate:
    from slam_init.methods.poselib import relative_pose_of_poselib

    camera = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [_FOCAL_PX, 0.0, 0.0]}
    x1, x2 = _points(bearings1), _points(bearings2)
    begin = time.process_time()
    pose, info = relative_pose_of_poselib(x1, x2, camera, threshold_rad * _FOCAL_PX, {"seed": seed, **options})
    seconds = time.process_time() - begin
    if info["num_inliers"] == 0:
        return Estimate((), seconds, "none")
    return Estimate(((np.array(pose.R), np.array(pose.t)),), seconds, "general")


def _pycolmap(bearings1: Floats, bearings2: Floats, threshold_rad: float, seed: int) -> Estimate:
    """The estimator behind COLMAP's geometric verification: E, F or H, chosen by counts of inliers."""
    import pycolmap

    x1, x2 = _points(bearings1), _points(bearings2)
    # Its check for watermarks tests the border of the image, so there must be a border around the points.
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
    """Pixels (N, 2) of the bearings in the camera of ``_FOCAL_PX``."""
    return np.ascontiguousarray(_FOCAL_PX * bearings[:, :2] / bearings[:, 2:])


#: Name -> required package, and the method. The default of PoseLib is at least 1000 samples; where most matches are
#: inliers it needs a tenth of that number.
METHODS: dict[str, tuple[str, Method]] = {
    "quest": ("quest", _quest),
    "OpenCV MAGSAC": ("cv2", partial(_opencv, "USAC_MAGSAC")),
    "OpenCV ACCURATE": ("cv2", partial(_opencv, "USAC_ACCURATE")),
    "PoseLib": ("poselib", partial(_poselib, {})),
    "PoseLib min 100": ("poselib", partial(_poselib, {"min_iterations": 100})),
    "pycolmap": ("pycolmap", _pycolmap),
}


def available(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """The methods whose package is installed, and the methods whose package is not."""
    here = [name for name in names if find_spec(METHODS[name][0])]
    return here, [name for name in names if name not in here]
