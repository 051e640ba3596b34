"""PoseLib's relative pose with its default options, and with fewer iterations; an optional package.

References
----------
.. [1] V. Larsson and contributors, "PoseLib - Minimal Solvers for Camera Pose Estimation", 2020,
   ``estimate_relative_pose``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slam_init.methods.gates import GATED_PAIRS, GateRules, accept_best
from slam_init.methods.two_view import TwoViewOutcome, check_matches
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict

__all__ = ["PoseLib", "PoseLibRules", "poselib_100"]


@dataclass(frozen=True)
class PoseLibRules:
    """The constants of ``poselib`` and ``poselib-100``.

    Attributes
    ----------
    max_epipolar_error_px : float
        Bound of the Sampson distance of an inlier; PoseLib's default.
    min_iterations : int
        Smallest number of RANSAC iterations. 1000 is PoseLib's default; its authors benchmark it with 100.
    min_matches : int
        Five matches have up to ten motions, and a sixth match chooses among them.
    gates : GateRules
    """

    max_epipolar_error_px: float = 1.0
    min_iterations: int = 1000
    min_matches: int = 6
    gates: GateRules = field(default_factory=GateRules)


class PoseLib:
    """Five-point LO-RANSAC with refinement [1]_, then cheirality and a parallax gate.

    Parameters
    ----------
    rules : PoseLibRules, optional
    """

    pair_rule = GATED_PAIRS

    def __init__(self, rules: PoseLibRules | None = None) -> None:
        self.rules = rules or PoseLibRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        import poselib

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.min_matches:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.min_matches})
        pinhole = {
            "model": "PINHOLE",
            "width": camera.width,
            "height": camera.height,
            "params": [camera.fx, camera.fy, camera.cx, camera.cy],
        }
        options = {
            "max_epipolar_error": rules.max_epipolar_error_px,
            "min_iterations": rules.min_iterations,
            "seed": seed,
        }
        pose, info = poselib.estimate_relative_pose(pixels1, pixels2, pinhole, pinhole, options, {})
        inliers = np.asarray(info["inliers"], bool)
        length = float(np.linalg.norm(pose.t))
        if len(inliers) != count or not inliers.any() or not length > 0:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t = np.asarray(pose.R, float)[None], np.asarray(pose.t, float)[None] / length
        return accept_best(camera, R, t, bearings1, bearings2, inliers, rules.gates, {})


def poselib_100() -> PoseLib:
    """Make the method ``poselib-100``, with the number of iterations of the benchmark of PoseLib's authors.

    Returns
    -------
    PoseLib
        With at least 100 RANSAC iterations.
    """
    return PoseLib(PoseLibRules(min_iterations=100))
