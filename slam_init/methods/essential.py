"""Methods that estimate one essential matrix, also on a plane: from five matches by OpenCV, or from eight matches.

References
----------
.. [1] D. Barath, J. Noskova, M. Ivashechkin, J. Matas, "MAGSAC++, a fast, reliable and accurate robust estimator",
   CVPR 2020; OpenCV, ``findEssentialMat`` with ``USAC_MAGSAC``.
.. [2] R. Hartley, "In defense of the eight-point algorithm", PAMI 1997.
.. [3] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, section 4.7 (RANSAC and the gates of its inliers).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quest.robust.samples import draw_samples
from slam_init.methods.gates import GATED_PAIRS, GateRules, accept_best
from slam_init.methods.models import fundamental_eight_point, normalize, normalizing_transform, sampson_errors
from slam_init.methods.motions import motions_of_essential
from slam_init.methods.two_view import TwoViewOutcome, check_matches
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class FivePointRules:
    """The constants of ``essential-5pt`` and its other name ``magsac``: the defaults of OpenCV."""

    confidence: float = 0.999
    #: Outlier threshold.
    threshold_px: float = 1.0
    #: Five matches have up to ten motions, and a sixth match chooses among them.
    min_matches: int = 6
    gates: GateRules = field(default_factory=GateRules)


class EssentialFivePoint:
    """OpenCV's five-point RANSAC with MAGSAC++ scores [1]_, then cheirality and a parallax gate.

    The random generator of OpenCV starts in the same state at each call, so the seed has no effect.
    """

    pair_rule = GATED_PAIRS

    def __init__(self, rules: FivePointRules | None = None) -> None:
        self.rules = rules or FivePointRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        import cv2

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.min_matches:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.min_matches})
        E, mask = cv2.findEssentialMat(
            pixels1, pixels2, camera.K, cv2.USAC_MAGSAC, rules.confidence, rules.threshold_px
        )
        if E is None or E.shape != (3, 3):
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t = motions_of_essential(np.asarray(E, float))
        inliers = np.asarray(mask.ravel() > 0)
        return accept_best(camera, R, t, bearings1, bearings2, inliers, rules.gates, {})


@dataclass(frozen=True)
class EightPointRules:
    """The constants of ``essential-8pt``."""

    #: As many as in ORB-SLAM. With 10 % of outliers, 43 of 100 samples of eight matches hold no outlier; with 40 %,
    #: two of 100.
    iterations: int = 200
    sample_size: int = 8
    #: Bound of the squared Sampson distance of an inlier: 95 % of chi-square with one degree of freedom, at a noise
    #: of 1 px [3]_.
    gate_px2: float = 3.841
    gates: GateRules = field(default_factory=GateRules)


class EssentialEightPoint:
    """Normalized eight-point fundamental matrices [2]_ in RANSAC; the best is fitted to its inliers and gives E."""

    pair_rule = GATED_PAIRS

    def __init__(self, rules: EightPointRules | None = None) -> None:
        self.rules = rules or EightPointRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.sample_size:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.sample_size})
        T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
        x1, x2 = normalize(T1, pixels1), normalize(T2, pixels2)
        drawn = draw_samples(np.random.default_rng(seed), count, rules.sample_size, rules.iterations)
        models = T2.T @ fundamental_eight_point(x1[drawn], x2[drawn]) @ T1
        errors = np.fmin(sampson_errors(models, pixels1, pixels2), rules.gate_px2)
        best = int(np.argmin(errors.sum(axis=1)))
        inliers = np.asarray(errors[best] < rules.gate_px2)
        if inliers.sum() < rules.sample_size:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, {"inliers": int(inliers.sum())})
        F = (T2.T @ fundamental_eight_point(x1[None, inliers], x2[None, inliers]) @ T1)[0]
        inliers = np.asarray(sampson_errors(F, pixels1, pixels2) < rules.gate_px2)
        R, t = motions_of_essential(camera.K.T @ F @ camera.K)
        return accept_best(camera, R, t, bearings1, bearings2, inliers, rules.gates, {})
