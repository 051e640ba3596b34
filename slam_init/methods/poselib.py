"""PoseLib's relative pose with its default options, and with fewer iterations; an optional package.

References
----------
.. [1] V. Larsson and contributors, "PoseLib - Minimal Solvers for Camera Pose Estimation", 2020,
   ``estimate_relative_pose``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from quest.geometry.epipolar import depths_from_pose
from quest.geometry.quaternion import quaternion_from_matrix
from quest.relative_pose import NoPose, PoseEvidence, RelativePose
from slam_init.config import Config
from slam_init.decision.two_views import MatchedPair
from slam_init.methods.essential import EssentialMethod, Motions
from slam_init.methods.two_view import Pair
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera


@dataclass(frozen=True)
class PoseLib(EssentialMethod):
    """Five-point LO-RANSAC with refinement [1]_, then cheirality and a parallax gate."""

    #: Bound of the Sampson distance of an inlier; PoseLib's default.
    max_epipolar_error_px: float = 1.0
    #: Smallest number of RANSAC iterations. 1000 is PoseLib's default; its authors benchmark it with 100.
    min_iterations: int = 1000

    def motions(self, pair: Pair) -> Motions | None:
        """Estimate the pose; None where PoseLib finds none."""
        camera = pair.camera
        size = {"model": "PINHOLE", "width": camera.width, "height": camera.height}
        pinhole = {**size, "params": [camera.K[0, 0], camera.K[1, 1], camera.cx, camera.cy]}
        ransac = {"min_iterations": self.min_iterations, "seed": pair.seed}
        error_px = self.max_epipolar_error_px
        pose, info = relative_pose_of_poselib(pair.pixels1, pair.pixels2, pinhole, error_px, ransac)
        inliers, length = np.asarray(info["inliers"], bool), float(np.linalg.norm(pose.t))
        if len(inliers) != len(pair) or not inliers.any() or not length > 0:
            return None
        return np.asarray(pose.R, float)[None], np.asarray(pose.t, float)[None] / length, inliers


def relative_pose_of_poselib(
    pixels1: Floats, pixels2: Floats, camera: dict[str, Any], max_error_px: float, ransac: dict[str, Any]
) -> tuple[Any, dict[str, Any]]:
    """Call PoseLib: version 2, which takes two flat dictionaries of options, or version 3 with its nested one."""
    import poselib

    options: tuple[dict[str, Any], ...] = ({"max_error": max_error_px, "ransac": ransac},)
    if int(poselib.__version__.split(".")[0]) < 3:
        options = {"max_epipolar_error": max_error_px, **ransac}, {}
    pose, info = poselib.estimate_relative_pose(pixels1, pixels2, camera, camera, *options)
    return pose, info


def poselib_100() -> PoseLib:
    """Make the method ``poselib-100``, with the number of iterations of the benchmark of PoseLib's authors."""
    return PoseLib(min_iterations=100)


def propose(camera: Camera, config: Config, pair: MatchedPair) -> tuple[RelativePose | NoPose, float]:
    """Propose PoseLib's relative pose to the window (the method ``poselib-window``).

    The window is that of ``quest``, so a comparison shows what comes from QuEst and what from the window.

    * Returns ``pose``: Of kind "general": PoseLib recognizes neither planes nor rotations.
    """
    method, m, n, count = PoseLib(), pair.rays1, pair.rays2, len(pair.rays1)
    threshold_rad = config.two_view.threshold_px / camera.focal_px
    if count < method.fewest:
        return NoPose("too_few_matches", PoseEvidence(count, needed=method.fewest)), threshold_rad
    motions = method.motions(Pair(camera, pair.pixels1, pair.pixels2, m, n, config.seed))
    if motions is None:
        return NoPose("no_consistent_motion", PoseEvidence(count)), threshold_rad
    (R,), (t,), inliers = motions
    depths1, depths2 = depths_from_pose(R, t, m, n)
    inliers &= (depths1 > 0) & (depths2 > 0)
    if inliers.sum() < method.fewest:
        return NoPose("no_consistent_motion", PoseEvidence(count)), threshold_rad
    turned, second = m[inliers] @ R.T, n[inliers]
    normal = np.cross(t, turned)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # The median of the absolute value of a Gaussian is 0.674 deviations; the noise of both rays is in the residual.
    noise_rad = float(np.median(np.abs(np.einsum("ij,ij->i", second, normal)))) / (0.674 * np.sqrt(2))
    parallax = np.arccos(np.clip(np.einsum("ij,ij->i", turned, second), -1.0, 1.0))
    pose = RelativePose(
        q_wxyz=quaternion_from_matrix(R),
        R=R,
        t=t,
        inliers=inliers,
        depths1=np.where(inliers, depths1, np.nan),
        depths2=np.where(inliers, depths2, np.nan),
        kind="general",
        alternatives=(),
        noise_rad=noise_rad,
        parallax_rad=float(np.median(parallax)),
        parallax=None,
        covariance=np.full((5, 5), np.nan),
        evidence=PoseEvidence(count, inliers=int(inliers.sum()), noise_rad=noise_rad),
    )
    return pose, threshold_rad
