"""The rules of COLMAP and OpenSfM for an initial pair: a five-point motion, or one of a plane, by their inliers.

References
----------
.. [1] J. L. Schoenberger, J.-M. Frahm, "Structure-from-Motion Revisited", CVPR 2016, section 4.1.
.. [2] COLMAP, ``estimators/two_view_geometry.cc`` and ``.h`` (options, EstimateCalibratedTwoViewGeometry).
.. [3] COLMAP, ``sfm/incremental_mapper.cc`` and ``.h`` (options, EstimateInitialTwoViewGeometry,
   RegisterInitialImagePair).
.. [4] OpenSfM, ``opensfm/reconstruction.py`` (compute_image_pairs, pairwise_reconstructability,
   two_view_reconstruction_general, reconstruction_from_relative_pose).
.. [5] OpenSfM, ``opensfm/config.py``.
.. [6] OpenSfM, ``opensfm/matching.py`` (compute_inliers_bearings), ``opensfm/multiview.py``
   (motion_from_plane_homography).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from quest.robust import kernels
from quest.robust.rotation import fit_rotation
from slam_init.methods.essential import five_point
from slam_init.methods.motions import (
    IN_FRONT,
    IN_FRONT_BY_MIDPOINTS,
    CheckRule,
    motions_of_essential,
    motions_of_homography,
)
from slam_init.methods.two_view import Evidence, Limit, Pair, PairRule, RuledMethod, TwoViewOutcome
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict


@dataclass(frozen=True)
class Colmap(RuledMethod):
    """The initial pair of COLMAP [1]_ as a two-view method. Each constant has its place in the sources.

    Departures from the sources: the robust loop is that of OpenCV (USAC_DEFAULT, also a LO-RANSAC). Its random
    generator starts in the same state at each call, so the seed has no effect. The method does not search a video for
    the pair with most matches. The thresholds are not relaxed if no pair meets them.
    """

    #: Half of the 100 inliers have more than the median angle and become landmarks.
    pair_rule: ClassVar[PairRule] = PairRule(min_features=100, min_matches=100, min_landmarks=50)

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

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        import cv2

        pixels, error_px, K = (pair.pixels1, pair.pixels2), self.max_error_px, pair.camera.K
        found = five_point(*pixels, K, cv2.USAC_DEFAULT, self.confidence, error_px, self.max_iterations)
        if found is None:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION)
        E, inliers = found
        H, mask = cv2.findHomography(*pixels, cv2.USAC_DEFAULT, error_px, None, self.max_iterations, self.confidence)
        inliers_H = np.asarray(mask.ravel() > 0) if H is not None else np.zeros(len(pair), bool)
        ratio = float(inliers_H.sum() / max(inliers.sum(), 1))
        planar = ratio > self.max_homography_ratio
        if planar and inliers_H.sum() >= inliers.sum():
            inliers = inliers_H
        count, few = int(inliers.sum()), self.min_inliers
        evidence: Evidence = {"homography_ratio": ratio, "homography_ratio_gate": self.max_homography_ratio}
        evidence |= {"inliers": count, "inliers_gate": few}
        if planar:
            of_rays = np.asarray(np.linalg.inv(K) @ H @ K, float)
            singular = np.linalg.svd(of_rays, compute_uv=False)
            turns_only = np.abs((singular / singular[1]) ** 2 - 1).max() < self.rotation_gate
            R, t = motions_of_homography(of_rays, np.inf if turns_only else 1.0)  # a rotation has no motions
        else:
            R, t = motions_of_essential(E)
        if len(R) == 0:
            return pair.refused(Verdict.PURE_ROTATION, evidence)
        check = pair.check(R, t, inliers, IN_FRONT)
        best, good, _ = check.best()
        # Only matches with a large enough angle become points. The median angle is over all matches in front.
        wide = CheckRule(float("inf"), np.cos(np.radians(self.min_angle_deg)), good // 2)
        chosen = pair.check(R[best, None], t[best, None], check.good[best], wide)
        angle, forward, least = float(chosen.parallax_deg[0]), float(abs(t[best, 2])), self.min_angle_deg
        limits = (
            Limit("parallax_deg", angle, least, angle <= least, Verdict.LOW_PARALLAX),
            Limit("forward", forward, self.max_forward, forward >= self.max_forward, Verdict.LOW_PARALLAX),
            Limit("inliers", count, few, count < few, Verdict.NO_CONSISTENT_MOTION),
        )
        return pair.decided(chosen, 0, planar, evidence, limits)


#: A rotation (3, 3), a unit translation (3,), and the matches (N,) within the threshold.
_Motion = tuple[Floats, Floats, Bools]


@dataclass(frozen=True)
class OpenSfm(RuledMethod):
    """The initial pair of OpenSfM as a two-view method. Errors are chords of unit rays, in radians.

    Departures from the sources: the robust loops are those of OpenCV (USAC_DEFAULT for E, RANSAC for H) and of quest
    (rotation); the motion is refined by Sampson errors with a robust kernel in place of reprojection errors. The method
    does not search all pairs for the one that contradicts a rotation most.

    As in the sources, the plane-based motion is the first of the eight motions of the homography. The code there means
    to take the one with most inliers, but compares a Python ``map`` object, of which NumPy returns position 0.
    """

    #: Pairs share 50 tracks at least (tracking.all_common_tracks).
    pair_rule: ClassVar[PairRule] = PairRule(min_features=50, min_matches=50, min_landmarks=20)

    #: Outlier threshold of the essential matrix, the homography and the inliers (five_point_algo_threshold [5]_).
    threshold_rad: float = 0.004
    #: The rotation-only test has this multiple of the threshold (_pair_reconstructability_arguments [4]_).
    rotation_factor: float = 4.0
    #: A pair is tried if at least this share of its matches contradicts a rotation (pairwise_reconstructability
    #: [4]_).
    min_outlier_ratio: float = 0.3
    confidence: float = 0.999
    #: Of RANSAC [4]_.
    max_iterations: int = 1000
    #: A homography has no motion if the ratio of two of its singular values is smaller [6]_.
    singular_ratio: float = 1.0001
    #: A refined five-point motion needs more inliers [4]_.
    min_five_point: int = 5
    #: Largest error of a landmark (triangulation_threshold [5]_).
    landmark_rad: float = 0.006
    #: Smallest angle between the rays of a landmark (triangulation_min_ray_angle [5]_).
    min_ray_angle_deg: float = 1.0
    #: Smallest number of landmarks (five_point_algo_min_inliers [5]_).
    min_points: int = 20

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        m, n, rotation_rad = pair.rays1, pair.rays2, self.rotation_factor * self.threshold_rad
        rotation, _ = fit_rotation(m, n, rotation_rad, np.random.default_rng(pair.seed))
        outliers = float(np.mean(np.linalg.norm(n - m @ rotation.T, axis=1) >= rotation_rad))
        evidence: Evidence = {"outlier_ratio": outliers, "outlier_ratio_gate": self.min_outlier_ratio}
        if outliers < self.min_outlier_ratio:
            return pair.refused(Verdict.LOW_PARALLAX, evidence)
        five_point_motion, plane = self._five_point(pair), self._plane(pair)
        counts = [0 if one is None else int(one[2].sum()) for one in (five_point_motion, plane)]
        evidence |= {"five_point_inliers": counts[0], "plane_inliers": counts[1]}
        planar = five_point_motion is None or counts[0] <= counts[1]
        chosen = plane if planar else five_point_motion
        if chosen is None:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION, evidence)
        R, t, _ = chosen
        points, near = _near(pair, R, t, self.landmark_rad)  # all common tracks, not the inliers alone
        wide = np.degrees(np.arccos(np.clip(np.sum((m @ R.T) * n, axis=1), -1, 1))) >= self.min_ray_angle_deg
        landmarks = near & wide
        evidence |= {"triangulated": int(landmarks.sum()), "triangulated_gate": self.min_points}
        if landmarks.sum() < self.min_points:
            few_wide = wide.sum() < self.min_points
            return pair.refused(Verdict.LOW_PARALLAX if few_wide else Verdict.TOO_FEW_LANDMARKS, evidence)
        return TwoViewOutcome.accepted(Pose(R, t), landmarks, points, planar, evidence)

    def _five_point(self, pair: Pair) -> _Motion | None:
        """The motion of the essential matrix, refined on its inliers; None if too few agree."""
        import cv2

        m, n, threshold = pair.rays1, pair.rays2, self.threshold_rad
        options = cv2.USAC_DEFAULT, self.confidence, threshold, self.max_iterations
        found = five_point(m[:, :2] / m[:, 2:], n[:, :2] / n[:, 2:], np.eye(3), *options)
        if found is None:
            return None
        R, t = motions_of_essential(found[0])
        inliers = [_near(pair, R[k], t[k], threshold)[1] for k in range(len(R))]
        best = int(np.argmax([one.sum() for one in inliers]))
        of_best = inliers[best]
        if of_best.sum() <= self.min_five_point:
            return None
        refined_R, refined_t = R[best].copy(), t[best].copy()
        kernels.refine(m, n, of_best, refined_R, refined_t, threshold, iterations=12)
        refined = _near(pair, refined_R, refined_t, threshold)[1]
        return (refined_R, refined_t, refined) if refined.sum() > self.min_five_point else None

    def _plane(self, pair: Pair) -> _Motion | None:
        """The first motion of the homography; None if it has none."""
        import cv2

        x1, x2 = (rays[:, :2] / rays[:, 2:] for rays in (pair.rays1, pair.rays2))
        H, _ = cv2.findHomography(x1, x2, cv2.RANSAC, self.threshold_rad)
        if H is None or not np.isfinite(H).all():
            return None
        R, t = motions_of_homography(np.asarray(H, float), self.singular_ratio)
        return None if len(R) == 0 else (R[0], t[0], _near(pair, R[0], t[0], self.threshold_rad)[1])


def _near(pair: Pair, R: Floats, t: Floats, threshold_rad: float) -> tuple[Floats, Bools]:
    """The midpoints of all matches, and which of them are seen within a chord of both rays, so in front of both."""
    # Wherever a midpoint lies: the rules of OpenSfM test the points themselves.
    points = pair.check(R[None], t[None], np.ones(len(pair), bool), IN_FRONT_BY_MIDPOINTS).points[0]
    with np.errstate(all="ignore"):  # parallel rays have no midpoint
        ray1 = points / np.linalg.norm(points, axis=1, keepdims=True)
        second = points @ R.T + t
        ray2 = second / np.linalg.norm(second, axis=1, keepdims=True)
        errors = np.linalg.norm(ray1 - pair.rays1, axis=1), np.linalg.norm(ray2 - pair.rays2, axis=1)
        return points, np.asarray((errors[0] < threshold_rad) & (errors[1] < threshold_rad))
