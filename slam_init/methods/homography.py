"""The rules of SVO: a homography for each scene, planar or not.

References
----------
.. [1] C. Forster, M. Pizzoli, D. Scaramuzza, "SVO: fast semi-direct monocular visual odometry", ICRA 2014.
.. [2] SVO, ``initialization.cpp`` (KltHomographyInit) and ``config.cpp``; its ``vikit`` ``homography.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quest.geometry.epipolar import sampson_error
from slam_init.methods.motions import CheckRule, check_motions, motions_of_homography
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class PlaneOnlyRules:
    """The constants, all from the configuration and the initialization of SVO [2]_."""

    #: The median displacement of the tracks has to be larger (initMinDisparity).
    min_disparity_px: float = 50.0
    #: Outlier threshold of the homography, and bound of the reprojection errors in both images (poseOptimThresh).
    threshold_px: float = 2.0
    #: Smallest number of points in front of both cameras with small reprojection errors (initMinInliers).
    min_inliers: int = 40
    #: If a second motion puts at least this share of the points in front, the epipolar error decides (vikit).
    rival_share: float = 0.9
    #: Features of a first frame (addFirstFrame).
    min_features: int = 100
    #: Tracks that are left of them (initMinTracked).
    min_matches: int = 50
    #: OpenCV's default for a homography, which SVO takes.
    confidence: float = 0.995
    #: Bounds the reprojection errors; no point is at infinity.
    check: CheckRule = field(default_factory=lambda: CheckRule(max_error_px=2.0, distant_cos=1.0, midpoint=True))


class PlaneOnly:
    """The initialization of SVO as a two-view method: a homography, the best of its eight motions, points in front.

    The method has no test for a rotation-only camera; such a pair is only refused if its points are not in front of
    both cameras. The random generator of OpenCV starts in the same state at each call, so the seed has no effect.
    """

    def __init__(self, rules: PlaneOnlyRules | None = None) -> None:
        self.rules = rules or PlaneOnlyRules()
        self.pair_rule = PairRule(self.rules.min_features, self.rules.min_matches, self.rules.min_inliers)

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        import cv2

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < 4:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": 4})
        disparity_px = float(np.median(np.linalg.norm(pixels2 - pixels1, axis=1)))
        evidence: Evidence = {"disparity_px": disparity_px, "disparity_px_gate": rules.min_disparity_px}
        if disparity_px < rules.min_disparity_px:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        H, mask = cv2.findHomography(
            pixels1, pixels2, cv2.USAC_DEFAULT, rules.threshold_px, confidence=rules.confidence
        )
        if H is None:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        # Each translation is accepted: there is none only if two singular values are equal to the last digit.
        R, t, _ = motions_of_homography(np.linalg.inv(camera.K) @ H @ camera.K, 1.0)
        if len(R) == 0:
            return TwoViewOutcome.refused(Verdict.PURE_ROTATION, count, evidence)
        best = self._best_motion(camera, R, t, bearings1, bearings2, np.asarray(mask.ravel() > 0))
        everything = np.ones(count, bool)
        check = check_motions(camera, R[best, None], t[best, None], bearings1, bearings2, everything, rules.check)
        inliers = int(check.good[0].sum())
        evidence |= {"good": inliers, "good_gate": rules.min_inliers}
        if inliers < rules.min_inliers:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        return TwoViewOutcome.accepted(check.pose(0), check.landmarks[0], check.points[0], True, evidence)

    def _best_motion(
        self, camera: Camera, R: Floats, t: Floats, bearings1: Floats, bearings2: Floats, inliers: Bools
    ) -> int:
        """Choose the motion with most points in front; of two similar ones, the one with less epipolar error."""
        in_front = CheckRule(max_error_px=float("inf"), distant_cos=1.0, midpoint=True)
        good = check_motions(camera, R, t, bearings1, bearings2, inliers, in_front).good.sum(axis=1)
        first, second = np.argsort(-good, kind="stable")[:2]
        if good[second] < self.rules.rival_share * good[first]:
            return int(first)
        gate_rad = self.rules.threshold_px / camera.focal_px
        errors = np.abs(sampson_error(R[[first, second]], t[[first, second]], bearings1, bearings2))
        cost = np.fmin(errors, gate_rad).sum(axis=1)
        return int(first if cost[0] <= cost[1] else second)
