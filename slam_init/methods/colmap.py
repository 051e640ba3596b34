"""The rules of COLMAP for an initial pair: essential matrix or homography by the ratio of inliers, and wide parallax.

References
----------
.. [1] J. L. Schoenberger, J.-M. Frahm, "Structure-from-Motion Revisited", CVPR 2016, section 4.1.
.. [2] COLMAP, ``estimators/two_view_geometry.cc`` and ``.h`` (options, EstimateCalibratedTwoViewGeometry).
.. [3] COLMAP, ``sfm/incremental_mapper.cc`` and ``.h`` (options, EstimateInitialTwoViewGeometry,
   RegisterInitialImagePair).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.methods.motions import IN_FRONT, CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class ColmapRules:
    """The constants of the rules, each with its place in the sources."""

    #: The pair is planar or panoramic if the inliers of H divided by those of E are more (max_H_inlier_ratio [2]_).
    max_homography_ratio: float = 0.8
    #: Outlier threshold of both models (init_max_error [3]_).
    max_error_px: float = 4.0
    confidence: float = 0.999
    max_iterations: int = 10_000
    #: A homography is a rotation if its squared singular values differ from one by less (DecomposeHomographyMatrix).
    rotation_gate: float = 1e-3
    #: Smallest number of inliers (init_min_num_inliers [3]_).
    min_inliers: int = 100
    #: Largest component of the unit baseline along the optical axis (init_max_forward_motion [3]_).
    max_forward: float = 0.95
    #: Smallest median triangulation angle (init_min_tri_angle [3]_). A point needs the same angle to be registered.
    min_angle_deg: float = 16.0


class Colmap:
    """The initial pair of COLMAP as a two-view method.

    Departures from the sources: the robust loop is that of OpenCV (USAC_DEFAULT, also a LO-RANSAC). Its random
    generator starts in the same state at each call, so the seed has no effect. The method does not search a video for
    the pair with most matches. The thresholds are not relaxed if no pair meets them.
    """

    #: Half of the 100 inliers have more than the median angle and become landmarks.
    pair_rule = PairRule(min_features=100, min_matches=100, min_landmarks=50)

    def __init__(self, rules: ColmapRules | None = None) -> None:
        self.rules = rules or ColmapRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        import cv2

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < 6:  # OpenCV needs a sixth match to choose among the motions of five matches
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": 6})
        E, mask_E = cv2.findEssentialMat(
            pixels1, pixels2, camera.K, cv2.USAC_DEFAULT, rules.confidence, rules.max_error_px, rules.max_iterations
        )
        H, mask_H = cv2.findHomography(
            pixels1, pixels2, cv2.USAC_DEFAULT, rules.max_error_px, None, rules.max_iterations, rules.confidence
        )
        if E is None or E.shape != (3, 3):
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        inliers_E = mask_E.ravel() > 0
        inliers_H = mask_H.ravel() > 0 if H is not None else np.zeros(count, bool)
        ratio = float(inliers_H.sum() / max(inliers_E.sum(), 1))
        planar = ratio > rules.max_homography_ratio
        evidence: Evidence = {"homography_ratio": ratio, "homography_ratio_gate": rules.max_homography_ratio}
        inliers = np.asarray(inliers_H if planar and inliers_H.sum() >= inliers_E.sum() else inliers_E)
        evidence |= {"inliers": int(inliers.sum()), "inliers_gate": rules.min_inliers}
        if planar:
            R, t = self._motions_of_plane(np.linalg.inv(camera.K) @ H @ camera.K)
        else:
            R, t = motions_of_essential(np.asarray(E, float))
        if len(R) == 0:
            return TwoViewOutcome.refused(Verdict.PURE_ROTATION, count, evidence)
        check = check_motions(camera, R, t, bearings1, bearings2, inliers, IN_FRONT)
        best = int(np.argmax(check.good.sum(axis=1)))
        # Only matches with a large enough angle become points. The median angle is over all matches in front.
        wide = CheckRule(float("inf"), np.cos(np.radians(rules.min_angle_deg)), int(check.good[best].sum()) // 2)
        chosen = check_motions(camera, R[best, None], t[best, None], bearings1, bearings2, check.good[best], wide)
        angle_deg, forward = float(chosen.parallax_deg[0]), float(abs(t[best, 2]))
        evidence |= {"parallax_deg": angle_deg, "parallax_deg_gate": rules.min_angle_deg}
        evidence |= {"forward": forward, "forward_gate": rules.max_forward}
        if angle_deg <= rules.min_angle_deg or forward >= rules.max_forward:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        if inliers.sum() < rules.min_inliers:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        return TwoViewOutcome.accepted(chosen.pose(0), chosen.landmarks[0], chosen.points[0], planar, evidence)

    def _motions_of_plane(self, H: Floats) -> tuple[Floats, Floats]:
        """Return the motions of a homography of rays; none if it is a rotation."""
        singular = np.linalg.svd(H, compute_uv=False)
        if np.abs((singular / singular[1]) ** 2 - 1).max() < self.rules.rotation_gate:
            return np.zeros((0, 3, 3)), np.zeros((0, 3))
        R, t, _ = motions_of_homography(H, 1.0)
        return R, t
