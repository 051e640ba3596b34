"""Methods that estimate one essential matrix, also on a plane: from five matches by OpenCV, or from eight matches.

Each subclass of :class:`EssentialMethod` brings its estimate; the gates on cheirality and parallax are the same.

References
----------
.. [1] D. Barath, J. Noskova, M. Ivashechkin, J. Matas, "MAGSAC++, a fast, reliable and accurate robust estimator",
   CVPR 2020; OpenCV, ``findEssentialMat`` with ``USAC_MAGSAC``.
.. [2] R. Hartley, "In defense of the eight-point algorithm", PAMI 1997.
.. [3] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, section 4.7 (RANSAC and the gates of its inliers).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from quest.robust.samples import draw_samples
from slam_init.methods.models import fundamental_eight_point, normalize, normalizing_transform, sampson_errors
from slam_init.methods.motions import IN_FRONT, check_motions, motions_of_essential
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict

#: The pair rule of these methods. It is that of ORB-SLAM, so that the methods are compared on the same pairs. As many
#: landmarks are required after bundle adjustment as points in front before it.
GATED_PAIRS = PairRule(min_features=101, min_matches=100, min_landmarks=50)

#: Rotations (K, 3, 3), unit translations (K, 3) and inliers (N,) of one essential matrix.
Motions = tuple[Floats, Floats, Bools]


@dataclass(frozen=True)
class GateRules:
    """The requirements on the best motion. ORB-SLAM and stella_vslam use the same numbers."""

    #: Smallest number of points in front of both cameras.
    min_in_front: int = 50
    #: The 51st largest parallax has to be larger.
    min_parallax_deg: float = 1.0


@dataclass(frozen=True)
class EssentialMethod(ABC):
    """The motion of one essential matrix that puts most inliers in front of both cameras, if it passes the gates."""

    pair_rule: ClassVar[PairRule] = GATED_PAIRS

    #: Five matches have up to ten motions, and a sixth match chooses among them.
    min_matches: int = 6
    gates: GateRules = field(default_factory=GateRules)

    @abstractmethod
    def motions(self, camera: Camera, pixels1: Floats, pixels2: Floats, seed: int) -> Motions | None:
        """Estimate the essential matrix; None where there is none."""

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, gates = check_matches(pixels1, pixels2, bearings1, bearings2), self.gates
        if count < self.min_matches:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": self.min_matches})
        motions = self.motions(camera, pixels1, pixels2, seed)
        if motions is None:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t, inliers = motions
        evidence: Evidence = {"inliers": int(inliers.sum())}
        if len(R) == 0:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        check = check_motions(camera, R, t, bearings1, bearings2, inliers, IN_FRONT)
        in_front = check.good.sum(axis=1)
        best = int(np.argmax(in_front))
        parallax_deg = float(check.parallax_deg[best])
        evidence |= {"in_front": int(in_front[best]), "in_front_gate": gates.min_in_front}
        evidence |= {"parallax_deg": parallax_deg, "parallax_deg_gate": gates.min_parallax_deg}
        if in_front[best] < gates.min_in_front:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        if parallax_deg <= gates.min_parallax_deg:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], False, evidence)


@dataclass(frozen=True)
class EssentialFivePoint(EssentialMethod):
    """OpenCV's five-point RANSAC with MAGSAC++ scores [1]_ and OpenCV's defaults; its other name is ``magsac``.

    The random generator of OpenCV starts in the same state at each call, so the seed has no effect.
    """

    confidence: float = 0.999
    #: Outlier threshold.
    threshold_px: float = 1.0

    def motions(self, camera: Camera, pixels1: Floats, pixels2: Floats, seed: int) -> Motions | None:
        """Estimate the essential matrix; None where there is none."""
        import cv2

        E, mask = cv2.findEssentialMat(pixels1, pixels2, camera.K, cv2.USAC_MAGSAC, self.confidence, self.threshold_px)
        if E is None or E.shape != (3, 3):
            return None
        return *motions_of_essential(np.asarray(E, float)), np.asarray(mask.ravel() > 0)


@dataclass(frozen=True)
class EssentialEightPoint(EssentialMethod):
    """Normalized eight-point fundamental matrices [2]_ in RANSAC; the best is fitted to its inliers and gives E."""

    #: The size of a sample as well.
    min_matches: int = 8
    #: As many as in ORB-SLAM. With 10 % of outliers, 43 of 100 samples of eight matches hold no outlier; with 40 %,
    #: two of 100.
    iterations: int = 200
    #: Bound of the squared Sampson distance of an inlier: 95 % of chi-square with one degree of freedom, at a noise
    #: of 1 px [3]_.
    gate_px2: float = 3.841

    def motions(self, camera: Camera, pixels1: Floats, pixels2: Floats, seed: int) -> Motions | None:
        """Estimate the essential matrix; no motion where fewer inliers than a sample are left."""
        T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
        x1, x2 = normalize(T1, pixels1), normalize(T2, pixels2)
        samples = draw_samples(np.random.default_rng(seed), len(x1), self.min_matches, self.iterations)
        models = T2.T @ fundamental_eight_point(x1[samples], x2[samples]) @ T1
        errors = np.fmin(sampson_errors(models, pixels1, pixels2), self.gate_px2)
        inliers = np.asarray(errors[int(np.argmin(errors.sum(axis=1)))] < self.gate_px2)
        if inliers.sum() < self.min_matches:
            return np.empty((0, 3, 3)), np.empty((0, 3)), inliers
        F = (T2.T @ fundamental_eight_point(x1[None, inliers], x2[None, inliers]) @ T1)[0]
        inliers = np.asarray(sampson_errors(F, pixels1, pixels2) < self.gate_px2)
        return *motions_of_essential(camera.K.T @ F @ camera.K), inliers
