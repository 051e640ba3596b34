"""PoseLib's relative pose with its default options, and with fewer iterations; an optional package.

References
----------
.. [1] V. Larsson and contributors, "PoseLib - Minimal Solvers for Camera Pose Estimation", 2020,
   ``estimate_relative_pose``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quest.geometry.epipolar import depths_from_pose
from quest.geometry.quaternion import quaternion_from_matrix
from quest.relative_pose import NoPose, PoseEvidence, RelativePose
from slam_init.config import Config
from slam_init.decision.two_views import MatchedPair
from slam_init.methods.gates import GATED_PAIRS, GateRules, accept_best
from slam_init.methods.two_view import TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class PoseLibRules:
    """The constants of ``poselib`` and ``poselib-100``."""

    #: Bound of the Sampson distance of an inlier; PoseLib's default.
    max_epipolar_error_px: float = 1.0
    #: Smallest number of RANSAC iterations. 1000 is PoseLib's default; its authors benchmark it with 100.
    min_iterations: int = 1000
    #: Five matches have up to ten motions, and a sixth match chooses among them.
    min_matches: int = 6
    gates: GateRules = field(default_factory=GateRules)


class PoseLib:
    """Five-point LO-RANSAC with refinement [1]_, then cheirality and a parallax gate."""

    pair_rule = GATED_PAIRS

    def __init__(self, rules: PoseLibRules | None = None) -> None:
        self.rules = rules or PoseLibRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.min_matches:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.min_matches})
        found = _estimated(camera, pixels1, pixels2, rules, seed)
        if found is None:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t, inliers = found
        return accept_best(camera, R[None], t[None], bearings1, bearings2, inliers, rules.gates, {})


def poselib_100() -> PoseLib:
    """Make the method ``poselib-100``, with the number of iterations of the benchmark of PoseLib's authors."""
    return PoseLib(PoseLibRules(min_iterations=100))


def propose(camera: Camera, config: Config, pair: MatchedPair) -> tuple[RelativePose | NoPose, float]:
    """Propose PoseLib's relative pose to the window (the method ``poselib-window``).

    The window is that of ``quest``, so a comparison shows what comes from QuEst and what from the window.

    * Returns ``pose``: Of kind "general": PoseLib tells neither planes nor rotations.
    """
    rules, m, n = PoseLibRules(), pair.rays1, pair.rays2
    threshold_rad = config.two_view.threshold_px / camera.focal_px
    count = len(m)
    if count < rules.min_matches:
        return NoPose("too_few_matches", PoseEvidence(count, needed=rules.min_matches)), threshold_rad
    found = _estimated(camera, pair.pixels1, pair.pixels2, rules, config.seed)
    depths1, depths2 = (None, None) if found is None else depths_from_pose(found[0], found[1], m, n)
    if found is None or depths1 is None or depths2 is None:
        return NoPose("no_consistent_motion", PoseEvidence(count)), threshold_rad
    R, t, inliers = found
    inliers &= (depths1 > 0) & (depths2 > 0)
    if inliers.sum() < rules.min_matches:
        return NoPose("no_consistent_motion", PoseEvidence(count)), threshold_rad
    normal = np.cross(t, m[inliers] @ R.T)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # The median of the absolute value of a Gaussian is 0.674 deviations; the noise of both rays is in the residual.
    noise_rad = float(np.median(np.abs(np.einsum("ij,ij->i", n[inliers], normal)))) / (0.674 * np.sqrt(2))
    turned = np.clip(np.einsum("ij,ij->i", m[inliers] @ R.T, n[inliers]), -1.0, 1.0)
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
        parallax_rad=float(np.median(np.arccos(turned))),
        parallax=None,
        covariance=np.full((5, 5), np.nan),
        evidence=PoseEvidence(count, inliers=int(inliers.sum()), noise_rad=noise_rad),
    )
    return pose, threshold_rad


def _estimated(
    camera: Camera, pixels1: Floats, pixels2: Floats, rules: PoseLibRules, seed: int
) -> tuple[Floats, Floats, Bools] | None:
    """Rotation, unit translation and inliers of PoseLib; None where it finds none."""
    import poselib

    K = camera.K
    pinhole = {
        "model": "PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [K[0, 0], K[1, 1], camera.cx, camera.cy],
    }
    options = {"max_epipolar_error": rules.max_epipolar_error_px, "min_iterations": rules.min_iterations, "seed": seed}
    pose, info = poselib.estimate_relative_pose(pixels1, pixels2, pinhole, pinhole, options, {})
    inliers = np.asarray(info["inliers"], bool)
    length = float(np.linalg.norm(pose.t))
    if len(inliers) != len(pixels1) or not inliers.any() or not length > 0:
        return None
    return np.asarray(pose.R, float), np.asarray(pose.t, float) / length, inliers
