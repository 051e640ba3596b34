"""Methods that estimate one model for each scene: an essential matrix, or a homography as SVO does.

References
----------
.. [1] D. Barath, J. Noskova, M. Ivashechkin, J. Matas, "MAGSAC++, a fast, reliable and accurate robust estimator",
   CVPR 2020; OpenCV, ``findEssentialMat`` with ``USAC_MAGSAC``.
.. [2] R. Hartley, "In defense of the eight-point algorithm", PAMI 1997.
.. [3] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, section 4.7 (RANSAC and the gates of its inliers).
.. [4] C. Forster, M. Pizzoli, D. Scaramuzza, "SVO: fast semi-direct monocular visual odometry", ICRA 2014.
.. [5] SVO, ``initialization.cpp`` (KltHomographyInit) and ``config.cpp``; its ``vikit`` ``homography.cpp``.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from quest.geometry.epipolar import sampson_error
from quest.robust.samples import draw_samples
from slam_init.methods.models import fundamentals, sampson_errors
from slam_init.methods.motions import IN_FRONT, IN_FRONT_BY_MIDPOINTS, CheckRule, motions_of_essential
from slam_init.methods.two_view import Evidence, Limit, Pair, PairRule, RuledMethod, TwoViewOutcome
from slam_init.types.arrays import Bools, Floats
from slam_init.types.refusal import Verdict

#: Rotations (K, 3, 3), unit translations (K, 3) and inliers (N,) of one essential matrix.
Motions = tuple[Floats, Floats, Bools]


def five_point(x1: Floats, x2: Floats, K: Floats, *options: Any) -> tuple[Floats, Bools] | None:
    """Estimate an essential matrix by OpenCV: the matrix and its inliers; None where OpenCV finds none.

    The random generator of OpenCV starts in the same state at each call, so the seed has no effect.
    """
    import cv2

    E, mask = cv2.findEssentialMat(x1, x2, K, *options)
    return None if E is None or E.shape != (3, 3) else (np.asarray(E, float), np.asarray(mask.ravel() > 0))


@dataclass(frozen=True)
class EssentialMethod(RuledMethod):
    """The motion of one essential matrix that puts most inliers in front of both cameras, if it passes the gates."""

    #: That of ORB-SLAM, so that the methods are compared on the same pairs. As many landmarks are required after bundle
    #: adjustment as points in front before it.
    pair_rule: ClassVar[PairRule] = PairRule(min_features=101, min_matches=100, min_landmarks=50)

    #: Smallest number of points in front of both cameras, as in ORB-SLAM and stella_vslam.
    min_in_front: int = 50
    #: The 51st largest parallax has to be larger, as in ORB-SLAM and stella_vslam.
    min_parallax_deg: float = 1.0

    @abstractmethod
    def motions(self, pair: Pair) -> Motions | None:
        """Estimate the essential matrix; None where there is none."""

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        motions = self.motions(pair)
        if motions is None:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION)
        R, t, inliers = motions
        evidence: Evidence = {"inliers": int(inliers.sum())}
        if len(R) == 0:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION, evidence)
        check = pair.check(R, t, inliers, IN_FRONT)
        best, in_front, parallax = check.best()
        few, low = self.min_in_front, self.min_parallax_deg
        limits = (
            Limit("in_front", in_front, few, in_front < few, Verdict.NO_CONSISTENT_MOTION),
            Limit("parallax_deg", parallax, low, parallax <= low, Verdict.LOW_PARALLAX),
        )
        return pair.decided(check, best, False, evidence, limits)


@dataclass(frozen=True)
class EssentialFivePoint(EssentialMethod):
    """OpenCV's five-point RANSAC with MAGSAC++ scores [1]_ and OpenCV's defaults; its other name is ``magsac``."""

    confidence: float = 0.999
    #: Outlier threshold.
    threshold_px: float = 1.0

    def motions(self, pair: Pair) -> Motions | None:
        """Estimate the essential matrix; None where there is none."""
        import cv2

        found = five_point(
            pair.pixels1, pair.pixels2, pair.camera.K, cv2.USAC_MAGSAC, self.confidence, self.threshold_px
        )
        return None if found is None else (*motions_of_essential(found[0]), found[1])


@dataclass(frozen=True)
class EssentialEightPoint(EssentialMethod):
    """Normalized eight-point fundamental matrices [2]_ in RANSAC; the best is fitted to its inliers and gives E."""

    #: The size of a sample as well.
    fewest: ClassVar[int] = 8
    #: As many as in ORB-SLAM. With 10 % of outliers, 43 of 100 samples of eight matches hold no outlier; with 40 %,
    #: two of 100.
    iterations: int = 200
    #: Bound of the squared Sampson distance of an inlier: 95 % of chi-square with one degree of freedom, at a noise
    #: of 1 px [3]_.
    gate_px2: float = 3.841

    def motions(self, pair: Pair) -> Motions | None:
        """Estimate the essential matrix; no motion where fewer inliers than a sample are left."""
        pixels = pair.pixels1, pair.pixels2
        samples = draw_samples(np.random.default_rng(pair.seed), len(pair), self.fewest, self.iterations)
        errors = np.fmin(sampson_errors(fundamentals(*pixels, samples), *pixels), self.gate_px2)
        inliers = np.asarray(errors[int(np.argmin(errors.sum(axis=1)))] < self.gate_px2)
        if inliers.sum() < self.fewest:
            return np.empty((0, 3, 3)), np.empty((0, 3)), inliers
        F = fundamentals(*pixels, np.flatnonzero(inliers)[None])[0]
        return *pair.motions(F, False, 1.0), np.asarray(sampson_errors(F, *pixels) < self.gate_px2)


@dataclass(frozen=True)
class PlaneOnly(RuledMethod):
    """The initialization of SVO [4]_: a homography, the best of its eight motions, points in front.

    The constants are those of the configuration and the initialization of SVO [5]_. The method has no test for a
    rotation-only camera; such a pair is only refused if its points are not in front of both cameras. The random
    generator of OpenCV starts in the same state at each call, so the seed has no effect.
    """

    #: Features of a first frame (addFirstFrame), tracks that are left of them (initMinTracked), and the inliers below.
    pair_rule: ClassVar[PairRule] = PairRule(min_features=100, min_matches=50, min_landmarks=40)
    fewest: ClassVar[int] = 4

    #: The median displacement of the tracks has to be larger (initMinDisparity).
    min_disparity_px: float = 50.0
    #: Outlier threshold of the homography, and bound of the reprojection errors in both images (poseOptimThresh).
    threshold_px: float = 2.0
    #: Smallest number of points in front of both cameras with small reprojection errors (initMinInliers).
    min_inliers: int = 40
    #: If a second motion puts at least this share of the points in front, the epipolar error decides (vikit).
    second_share: float = 0.9
    #: OpenCV's default for a homography, which SVO takes.
    confidence: float = 0.995

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        import cv2

        disparity_px = float(np.median(np.linalg.norm(pair.pixels2 - pair.pixels1, axis=1)))
        evidence: Evidence = {"disparity_px": disparity_px, "disparity_px_gate": self.min_disparity_px}
        if disparity_px < self.min_disparity_px:
            return pair.refused(Verdict.LOW_PARALLAX, evidence)
        H, mask = cv2.findHomography(
            pair.pixels1, pair.pixels2, cv2.USAC_DEFAULT, self.threshold_px, confidence=self.confidence
        )
        if H is None:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION, evidence)
        # Each translation is accepted: there is none only if two singular values are equal to the last digit.
        R, t = pair.motions(np.asarray(H, float), True, 1.0)
        if len(R) == 0:
            return pair.refused(Verdict.PURE_ROTATION, evidence)
        best = self._best_motion(pair, R, t, np.asarray(mask.ravel() > 0))
        rule = CheckRule(max_error_px=self.threshold_px, distant_cos=1.0, midpoint=True)
        check = pair.check(R[best, None], t[best, None], np.ones(len(pair), bool), rule)
        good, few = int(check.good[0].sum()), self.min_inliers
        limit = Limit("good", good, few, good < few, Verdict.NO_CONSISTENT_MOTION)
        return pair.decided(check, 0, True, evidence, (limit,))

    def _best_motion(self, pair: Pair, R: Floats, t: Floats, inliers: Bools) -> int:
        """Choose the motion with most points in front; of two similar ones, the one with less epipolar error."""
        good = pair.check(R, t, inliers, IN_FRONT_BY_MIDPOINTS).good.sum(axis=1)
        first, second = np.argsort(-good, kind="stable")[:2]
        if good[second] < self.second_share * good[first]:
            return int(first)
        gate_rad = self.threshold_px / pair.camera.focal_px
        errors = np.abs(sampson_error(R[[first, second]], t[[first, second]], pair.rays1, pair.rays2))
        cost = np.fmin(errors, gate_rad).sum(axis=1)
        return int(first if cost[0] <= cost[1] else second)
