"""The rules of OpenSfM for an initial pair: rotation-only test, then five-point or plane-based motion by their inliers.

References
----------
.. [1] OpenSfM, ``opensfm/reconstruction.py`` (compute_image_pairs, pairwise_reconstructability,
   two_view_reconstruction_general, reconstruction_from_relative_pose).
.. [2] OpenSfM, ``opensfm/config.py``.
.. [3] OpenSfM, ``opensfm/matching.py`` (compute_inliers_bearings), ``opensfm/multiview.py``
   (motion_from_plane_homography).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.geometry.refine import refine_pose
from quest.robust.rotation import fit_rotation
from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict

#: Each match is triangulated at the midpoint, wherever it lies: the rules of this module test the points themselves.
_MIDPOINTS = CheckRule(max_error_px=float("inf"), distant_cos=1.0, midpoint=True)


@dataclass(frozen=True)
class OpenSfmRules:
    """The constants of the rules, each with its place in the sources. Errors are chords of unit rays, in radians."""

    #: Outlier threshold of the essential matrix, the homography and the inliers (five_point_algo_threshold [2]_).
    threshold_rad: float = 0.004
    #: The rotation-only test has this multiple of the threshold (_pair_reconstructability_arguments [1]_).
    rotation_factor: float = 4.0
    #: A pair is tried if at least this share of its matches contradicts a rotation (pairwise_reconstructability
    #: [1]_).
    min_outlier_ratio: float = 0.3
    confidence: float = 0.999
    #: Of RANSAC [1]_.
    max_iterations: int = 1000
    #: A homography has no motion if the ratio of two of its singular values is smaller [3]_.
    singular_ratio: float = 1.0001
    #: A refined five-point motion needs more inliers [1]_.
    min_five_point: int = 5
    #: Largest error of a landmark (triangulation_threshold [2]_).
    landmark_rad: float = 0.006
    #: Smallest angle between the rays of a landmark (triangulation_min_ray_angle [2]_).
    min_ray_angle_deg: float = 1.0
    #: Smallest number of landmarks (five_point_algo_min_inliers [2]_).
    min_points: int = 20


class OpenSfm:
    """The initial pair of OpenSfM as a two-view method.

    Departures from the sources: the robust loops are those of OpenCV (USAC_DEFAULT for E, RANSAC for H) and of quest
    (rotation); the motion is refined by Sampson errors with a robust kernel in place of reprojection errors. The method
    does not search all pairs for the one that contradicts a rotation most.

    As in the sources, the plane-based motion is the first of the eight motions of the homography. The code there means
    to take the one with most inliers, but compares a Python ``map`` object, of which NumPy returns position 0.
    """

    #: Pairs share 50 tracks at least (tracking.all_common_tracks).
    pair_rule = PairRule(min_features=50, min_matches=50, min_landmarks=20)

    def __init__(self, rules: OpenSfmRules | None = None) -> None:
        self.rules = rules or OpenSfmRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, rules, m, n = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules, bearings1, bearings2
        if count < 6:  # OpenCV needs a sixth match to choose among the motions of five matches
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": 6})
        rotation_rad = rules.rotation_factor * rules.threshold_rad
        rotation, _ = fit_rotation(m, n, rotation_rad, np.random.default_rng(seed))
        outliers = float(np.mean(np.linalg.norm(n - m @ rotation.T, axis=1) >= rotation_rad))
        evidence: Evidence = {"outlier_ratio": outliers, "outlier_ratio_gate": rules.min_outlier_ratio}
        if outliers < rules.min_outlier_ratio:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        five_point, plane = self._five_point(camera, m, n), self._plane(camera, m, n)
        counts = [0 if one is None else int(one[2].sum()) for one in (five_point, plane)]
        evidence |= {"five_point_inliers": counts[0], "plane_inliers": counts[1]}
        planar = five_point is None or counts[0] <= counts[1]
        chosen = plane if planar else five_point
        if chosen is None:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        R, t, _ = chosen
        # All common tracks are triangulated, not the inliers alone.
        check = check_motions(camera, R[None], t[None], m, n, np.ones(count, bool), _MIDPOINTS)
        angle_deg = np.degrees(np.arccos(np.clip(np.sum((m @ R.T) * n, axis=1), -1, 1)))
        landmarks = _near(check.points[0], R, t, m, n, rules.landmark_rad) & (angle_deg >= rules.min_ray_angle_deg)
        evidence |= {"triangulated": int(landmarks.sum()), "triangulated_gate": rules.min_points}
        if landmarks.sum() < rules.min_points:
            wide = int(np.sum(angle_deg >= rules.min_ray_angle_deg))
            reason = Verdict.LOW_PARALLAX if wide < rules.min_points else Verdict.TOO_FEW_LANDMARKS
            return TwoViewOutcome.refused(reason, count, evidence)
        return TwoViewOutcome.accepted(check.pose(0), landmarks, check.points[0], planar, evidence)

    def _five_point(self, camera: Camera, m: Floats, n: Floats) -> tuple[Floats, Floats, Bools] | None:
        """The motion of the essential matrix, refined on its inliers; None if too few agree."""
        import cv2

        rules = self.rules
        x1, x2 = m[:, :2] / m[:, 2:], n[:, :2] / n[:, 2:]
        E, _ = cv2.findEssentialMat(
            x1, x2, np.eye(3), cv2.USAC_DEFAULT, rules.confidence, rules.threshold_rad, rules.max_iterations
        )
        if E is None or E.shape != (3, 3):
            return None
        R, t = motions_of_essential(np.asarray(E, float))
        inliers = [self._inliers(camera, R[k], t[k], m, n) for k in range(len(R))]
        best = int(np.argmax([one.sum() for one in inliers]))
        of_best = inliers[best]
        if of_best.sum() <= rules.min_five_point:
            return None
        refined_R, refined_t = refine_pose(R[best], t[best], m[of_best], n[of_best], rules.threshold_rad)
        refined = self._inliers(camera, refined_R, refined_t, m, n)
        return (refined_R, refined_t, refined) if refined.sum() > rules.min_five_point else None

    def _plane(self, camera: Camera, m: Floats, n: Floats) -> tuple[Floats, Floats, Bools] | None:
        """The first motion of the homography; None if it has none."""
        import cv2

        x1, x2 = m[:, :2] / m[:, 2:], n[:, :2] / n[:, 2:]
        H, _ = cv2.findHomography(x1, x2, cv2.RANSAC, self.rules.threshold_rad)
        if H is None or not np.isfinite(H).all():
            return None
        R, t, _ = motions_of_homography(np.asarray(H, float), self.rules.singular_ratio)
        return None if len(R) == 0 else (R[0], t[0], self._inliers(camera, R[0], t[0], m, n))

    def _inliers(self, camera: Camera, R: Floats, t: Floats, m: Floats, n: Floats) -> Bools:
        """The matches whose midpoint is seen within the threshold in both views."""
        points = check_motions(camera, R[None], t[None], m, n, np.ones(len(m), bool), _MIDPOINTS).points[0]
        return _near(points, R, t, m, n, self.rules.threshold_rad)


def _near(points: Floats, R: Floats, t: Floats, m: Floats, n: Floats, threshold_rad: float) -> Bools:
    """The points whose directions differ by less than a chord from both rays. Such a point lies in front of both."""
    with np.errstate(all="ignore"):  # parallel rays have no midpoint
        ray1 = points / np.linalg.norm(points, axis=1, keepdims=True)
        second = points @ R.T + t
        ray2 = second / np.linalg.norm(second, axis=1, keepdims=True)
        near = (np.linalg.norm(ray1 - m, axis=1) < threshold_rad) & (np.linalg.norm(ray2 - n, axis=1) < threshold_rad)
    return np.asarray(near)
