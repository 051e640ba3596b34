"""The rules of pySLAM: five-point MAGSAC on pairs at most five frames apart, 150 points, cells of the image covered.

References
----------
.. [1] pySLAM, ``pyslam/slam/initializer.py`` (initialize_simple, process_frames).
.. [2] pySLAM, ``pyslam/config_parameters.py``.
.. [3] pySLAM, ``pyslam/slam/map.py`` (add_points).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.methods.motions import IN_FRONT, CheckRule, check_motions, motions_of_essential
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class PySlamRules:
    """The constants of the rules, each with its place in the sources."""

    #: Outlier threshold of the essential matrix in normalized coordinates (kRansacThresholdNormalized [1]_).
    threshold: float = 0.0004
    #: kRansacProb [1]_.
    confidence: float = 0.999
    #: Largest squared reprojection error of a point, for a noise of one pixel (kChi2Mono [2]_).
    max_error_px2: float = 5.991
    #: A point needs a smaller cosine of its parallax, which is a third of a degree (kCosMaxParallaxInitializer [2]_).
    max_cosine: float = 0.99998
    #: More points are needed (kInitializerNumMinTriangulatedPoints [2]_).
    min_points: int = 150
    #: Share of these points that is needed after many failures [1]_.
    relaxed_share: float = 2 / 3
    #: The number of refused pairs after which the rules are relaxed. The sources count 10 failures, and of five pairs
    #: with a reference one fails because its frames are too close; this one is not counted here.
    relaxed_after: int = 8
    #: Largest ratio of the median depth and the baseline (kInitializerMinRatioDepthBaseline [2]_).
    max_depth_ratio: float = 100.0
    #: Each of this number of rows and columns of the image needs a point in each cell [1]_.
    cells: int = 3


class PySlam:
    """The initializer of pySLAM as a two-view method.

    The reference is replaced after five frames, and its next frame is not tried (:attr:`pair_rule`). After many
    failures the rules are relaxed, for good: so the method remembers its failures, and each run needs one of its own.

    Departures from the sources: tracks have no octaves, so all points have a noise of one pixel. The test that bundle
    adjustment lowers the error is not repeated, because bundle adjustment here never raises it. The number of landmarks
    after bundle adjustment is compared with the relaxed bound.
    """

    #: kInitializerNumMinFeatures, kMinIdDistBetweenIntializingFrames, kMaxIdDistBetweenIntializingFrames.
    pair_rule = PairRule(min_features=100, min_matches=5, min_landmarks=100, min_gap=2, max_gap=5)

    def __init__(self, rules: PySlamRules | None = None) -> None:
        self.rules = rules or PySlamRules()
        self._failures = 0

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        outcome = self._judge(camera, pixels1, pixels2, bearings1, bearings2)
        self._failures += not outcome
        return outcome

    def _judge(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats
    ) -> TwoViewOutcome:
        import cv2

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < 6:  # OpenCV needs a sixth match to choose among the motions of five matches
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": 6})
        relaxed = self._failures > rules.relaxed_after
        needed = rules.relaxed_share * rules.min_points if relaxed else float(rules.min_points)
        x1, x2 = (rays[:, :2] / rays[:, 2:] for rays in (bearings1, bearings2))
        E, mask = cv2.findEssentialMat(x1, x2, np.eye(3), cv2.USAC_MAGSAC, rules.confidence, rules.threshold)
        if E is None or E.shape != (3, 3):
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t = motions_of_essential(np.asarray(E, float))
        # The motion with most matches in front; the outliers of RANSAC vote as well, as in recoverPose without a mask.
        everywhere = check_motions(camera, R, t, bearings1, bearings2, np.ones(count, bool), IN_FRONT)
        best = int(np.argmax(everywhere.good.sum(axis=1)))
        near = CheckRule(float(np.sqrt(rules.max_error_px2)), rules.max_cosine)
        inliers = np.asarray(mask.ravel() > 0)
        check = check_motions(camera, R[best, None], t[best, None], bearings1, bearings2, inliers, near)
        landmarks, points = check.landmarks[0], check.points[0]
        found = int(landmarks.sum())
        evidence: Evidence = {"triangulated": found, "triangulated_gate": needed}
        if found <= needed:
            # The sources give no reasons. Inliers that are too few with their parallax and enough without are too far.
            reason = Verdict.LOW_PARALLAX if inliers.sum() > needed else Verdict.NO_CONSISTENT_MOTION
            return TwoViewOutcome.refused(reason, count, evidence)
        depth = float(np.median((points[landmarks] @ R[best].T + t[best])[:, 2]))  # in units of the baseline
        evidence |= {"depth_over_baseline": depth, "depth_over_baseline_gate": rules.max_depth_ratio}
        if not 0 < depth <= rules.max_depth_ratio:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        covered = self._covered_cells(camera, pixels2[landmarks])
        evidence |= {"covered_cells": int(covered.sum()), "covered_cells_gate": 0 if relaxed else rules.cells**2}
        if not (relaxed or covered.all()):
            return TwoViewOutcome.refused(Verdict.TOO_FEW_LANDMARKS, count, evidence)
        return TwoViewOutcome.accepted(check.pose(0), landmarks, points, False, evidence)

    def _covered_cells(self, camera: Camera, pixels: Floats) -> Bools:
        """Which cells of the image hold a point."""
        cells = self.rules.cells
        column = np.clip(pixels[:, 0] * cells // camera.width, 0, cells - 1).astype(int)
        row = np.clip(pixels[:, 1] * cells // camera.height, 0, cells - 1).astype(int)
        covered = np.zeros((cells, cells), bool)
        covered[row, column] = True
        return covered
