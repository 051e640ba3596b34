"""The rules of ORB-SLAM: homography or fundamental matrix by the ratio of their scores, then one distinct motion.

References
----------
.. [1] R. Mur-Artal, J. M. M. Montiel, J. D. Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system",
   T-RO 2015, section IV.
.. [2] ORB-SLAM2, ``Initializer.cc`` and ``Tracking.cc`` (MonocularInitialization, CreateInitialMapMonocular).
.. [3] ORB-SLAM3 v1.0, ``TwoViewReconstruction.cc`` and ``Tracking.cc``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quest.robust.samples import draw_samples
from slam_init.methods.models import (
    epipolar_errors,
    fundamental_eight_point,
    homography_dlt,
    normalize,
    normalizing_transform,
    transfer_errors,
)
from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class OrbSlamRules:
    """The constants of the rules, each with its place in the sources [1]_ [2]_ [3]_."""

    #: The homography is taken if its share of the sum of both scores is larger: 0.45 in [1]_, 0.40 in [2]_, 0.50 in
    #: [3]_ (Reconstruct).
    homography_score_share: float
    #: Required number of landmarks after bundle adjustment: 100 in [2]_, 50 in [3]_ (CreateInitialMapMonocular).
    min_tracked: int
    #: Number of samples; both models use the same samples (constructor; Reconstruct).
    iterations: int = 200
    #: Matches in a sample.
    sample_size: int = 8
    #: homography_gate_px2, fundamental_gate_px2: Bounds of the squared error of an inlier: 95 % of chi-square with
    #: two and with one degree of freedom, at a noise of one pixel. The score of an inlier of either model is the
    #: first bound minus its error (CheckHomography, CheckFundamental).
    homography_gate_px2: float = 5.991
    fundamental_gate_px2: float = 3.841
    #: Required share of the inliers that count for the motion (ReconstructF, ReconstructH).
    min_good_share: float = 0.9
    #: Required number of matches that count for the motion (ReconstructF, ReconstructH).
    min_triangulated: int = 50
    #: rival_share_fundamental, rival_share_homography: No second motion may have more than this share of the matches
    #: of the best motion (ReconstructF; ReconstructH).
    rival_share_fundamental: float = 0.7
    rival_share_homography: float = 0.75
    #: The 51st largest parallax has to be larger (Reconstruct, CheckRT).
    min_parallax_deg: float = 1.0
    #: A homography has no motion if the ratio of two of its singular values is nearer to one (ReconstructH).
    singular_ratio: float = 1.00001
    #: Reprojection errors within 2 px. A point is at infinity if the cosine of its parallax is larger, which is 0.36
    #: degrees (ReconstructF, CheckRT).
    check: CheckRule = field(default_factory=lambda: CheckRule(max_error_px=2.0, distant_cos=0.99998))
    #: min_features, min_matches: More than 100 features in both frames, and at least 100 matches
    #: (MonocularInitialization).
    min_features: int = 101
    min_matches: int = 100


class OrbSlam:
    """The initialization of ORB-SLAM as a two-view method.

    Departures from the sources: double precision, and the random generator.
    """

    def __init__(self, rules: OrbSlamRules) -> None:
        self.rules = rules
        self.pair_rule = PairRule(rules.min_features, rules.min_matches, rules.min_tracked)

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.sample_size:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.sample_size})
        samples = draw_samples(np.random.default_rng(seed), count, rules.sample_size, rules.iterations)
        H, score_H, inliers_H = self._best_homography(pixels1, pixels2, samples)
        F, score_F, inliers_F = self._best_fundamental(pixels1, pixels2, samples)
        if score_H + score_F == 0:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        share = score_H / (score_H + score_F)
        planar = share > rules.homography_score_share
        evidence: Evidence = {
            "homography_score_share": share,
            "homography_score_share_gate": rules.homography_score_share,
        }
        inliers = inliers_H if planar else inliers_F
        if planar:
            R, t, _ = motions_of_homography(np.linalg.inv(camera.K) @ H @ camera.K, rules.singular_ratio)
        else:
            R, t = motions_of_essential(camera.K.T @ F @ camera.K)
        if len(R) == 0:
            return TwoViewOutcome.refused(Verdict.PURE_ROTATION, count, evidence)
        check = check_motions(camera, R, t, bearings1, bearings2, inliers, rules.check)
        good = check.good.sum(axis=1)
        best = int(np.argmax(good))
        rival_share = rules.rival_share_homography if planar else rules.rival_share_fundamental
        needed = _needed(rules, int(inliers.sum()), planar)
        rival = float(np.delete(good, best).max() / max(good[best], 1))
        parallax_deg = float(check.parallax_deg[best])
        evidence |= {"inliers": int(inliers.sum()), "good": int(good[best]), "good_gate": needed}
        evidence |= {"rival_share": rival, "rival_share_gate": rival_share}
        evidence |= {"parallax_deg": parallax_deg, "parallax_deg_gate": rules.min_parallax_deg}
        # The sources give no reasons; these follow the list of this project. The number of good points
        # comes first, since a few points have no reliable parallax.
        if good[best] < rules.min_triangulated:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        if parallax_deg < rules.min_parallax_deg:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        if good[best] < needed:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        # As in the sources: a rival exactly at the bound refuses a homography, and not a fundamental matrix.
        if rival >= rival_share if planar else rival > rival_share:
            return TwoViewOutcome.refused(Verdict.AMBIGUOUS_PLANE, count, evidence)
        return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], planar, evidence)

    def _best_homography(self, pixels1: Floats, pixels2: Floats, samples: Ints) -> tuple[Floats, float, Bools]:
        T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
        normalized = homography_dlt(normalize(T1, pixels1)[samples], normalize(T2, pixels2)[samples])
        models = np.linalg.inv(T2) @ normalized @ T1
        gate = self.rules.homography_gate_px2
        return _best(models, transfer_errors(models, pixels1, pixels2), gate, gate)

    def _best_fundamental(self, pixels1: Floats, pixels2: Floats, samples: Ints) -> tuple[Floats, float, Bools]:
        T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
        normalized = fundamental_eight_point(normalize(T1, pixels1)[samples], normalize(T2, pixels2)[samples])
        models = T2.T @ normalized @ T1
        gate, full = self.rules.fundamental_gate_px2, self.rules.homography_gate_px2
        return _best(models, epipolar_errors(models, pixels1, pixels2), gate, full)


def orb_slam3() -> OrbSlam:
    """Make the method with the rules of ORB-SLAM3 v1.0."""
    return OrbSlam(OrbSlamRules(homography_score_share=0.50, min_tracked=50))


def orb_slam2() -> OrbSlam:
    """Make the method with the rules of ORB-SLAM2."""
    return OrbSlam(OrbSlamRules(homography_score_share=0.40, min_tracked=100))


def _best(models: Floats, errors: tuple[Floats, Floats], gate: float, full: float) -> tuple[Floats, float, Bools]:
    """Return the model (3, 3) of the highest score, the score, and the matches (N,) within the gate in both images."""
    within = [error <= gate for error in errors]  # False for NaN
    score = sum(np.where(ok, full - error, 0.0).sum(axis=1) for ok, error in zip(within, errors, strict=True))
    best = int(np.argmax(score))
    return models[best], float(score[best]), within[0][best] & within[1][best]


def _needed(rules: OrbSlamRules, inliers: int, planar: bool) -> int:
    """Return the number of good points that a motion needs."""
    if planar:  # more than both bounds
        return max(int(np.floor(rules.min_good_share * inliers)), rules.min_triangulated) + 1
    return max(int(rules.min_good_share * inliers), rules.min_triangulated)
