"""The rules of ORB-SLAM and stella_vslam: homography or fundamental matrix by their scores, then one distinct motion.

References
----------
.. [1] R. Mur-Artal, J. M. M. Montiel, J. D. Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system",
   T-RO 2015, section IV.
.. [2] ORB-SLAM2, ``Initializer.cc`` and ``Tracking.cc`` (MonocularInitialization, CreateInitialMapMonocular).
.. [3] ORB-SLAM3 v1.0, ``TwoViewReconstruction.cc`` and ``Tracking.cc``.
.. [4] stella_vslam, ``solve/homography_solver.cc``, ``solve/fundamental_solver.cc``.
.. [5] stella_vslam, ``initialize/perspective.cc``, ``initialize/base.cc``.
.. [6] stella_vslam, ``module/initializer.cc``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from quest.robust.samples import draw_samples
from slam_init.methods.models import epipolar_errors, fundamentals, homographies, sampson_errors, transfer_errors
from slam_init.methods.motions import CheckRule
from slam_init.methods.two_view import Evidence, Limit, Pair, PairRule, RuledMethod, TwoViewOutcome
from slam_init.types.arrays import Bools, Floats
from slam_init.types.refusal import Verdict


@dataclass(frozen=True)
class OrbSlam(RuledMethod):
    """The initialization of ORB-SLAM as a two-view method. Each constant has its place in the sources [1]_ [2]_ [3]_.

    Departures from the sources: double precision, and the random generator.
    """

    fewest: ClassVar[int] = 8

    #: More than 100 features in both frames, and at least 100 matches (MonocularInitialization); 100 landmarks after
    #: bundle adjustment in [2]_, 50 in [3]_ (CreateInitialMapMonocular).
    pair_rule: PairRule
    #: The homography is taken if its share of the sum of both scores is larger: 0.45 in [1]_, 0.40 in [2]_, 0.50 in
    #: [3]_ (Reconstruct).
    homography_score_share: float
    #: Number of samples of eight matches; both models use the same samples (constructor; Reconstruct).
    iterations: int = 200
    #: homography_gate_px2, fundamental_gate_px2: Bounds of the squared error of an inlier: 95 % of chi-square with
    #: two and with one degree of freedom, at a noise of one pixel. The score of an inlier of either model is the
    #: first bound minus its error (CheckHomography, CheckFundamental).
    homography_gate_px2: float = 5.991
    fundamental_gate_px2: float = 3.841
    #: Required share of the inliers that count for the motion (ReconstructF, ReconstructH).
    min_good_share: float = 0.9
    #: Required number of matches that count for the motion (ReconstructF, ReconstructH).
    min_triangulated: int = 50
    #: second_fundamental, second_homography: No second motion may have more than this share of the matches
    #: of the best motion (ReconstructF; ReconstructH).
    second_fundamental: float = 0.7
    second_homography: float = 0.75
    #: The 51st largest parallax has to be larger (Reconstruct, CheckRT).
    min_parallax_deg: float = 1.0
    #: A homography has no motion if the ratio of two of its singular values is nearer to one (ReconstructH).
    singular_ratio: float = 1.00001
    #: Reprojection errors within 2 px. A point is at infinity if the cosine of its parallax is larger, which is 0.36
    #: degrees (ReconstructF, CheckRT).
    check: ClassVar[CheckRule] = CheckRule(max_error_px=2.0, distant_cos=0.99998)

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        pixels, gate_H, gate_F = (pair.pixels1, pair.pixels2), self.homography_gate_px2, self.fundamental_gate_px2
        samples = draw_samples(np.random.default_rng(pair.seed), len(pair), self.fewest, self.iterations)
        H, F = homographies(*pixels, samples), fundamentals(*pixels, samples)
        H, score_H, inliers_H = _highest(H, transfer_errors(H, *pixels), gate_H, gate_H)
        F, score_F, inliers_F = _highest(F, epipolar_errors(F, *pixels), gate_F, gate_H)
        if score_H + score_F == 0:
            return pair.refused(Verdict.NO_CONSISTENT_MOTION)
        share = score_H / (score_H + score_F)
        bound = self.homography_score_share
        planar = share > bound
        evidence: Evidence = {"homography_score_share": share, "homography_score_share_gate": bound}
        model, inliers = (H, inliers_H) if planar else (F, inliers_F)
        R, t = pair.motions(model, planar, self.singular_ratio)
        if len(R) == 0:
            return pair.refused(Verdict.PURE_ROTATION, evidence)
        check = pair.check(R, t, inliers, self.check)
        best, good, parallax = check.best()
        second, most = check.second_share(), self.second_homography if planar else self.second_fundamental
        count, low = int(inliers.sum()), self.min_parallax_deg
        # A homography needs more than both bounds.
        needed = max(int(self.min_good_share * count), self.min_triangulated) + planar
        # As in the sources: a competing motion exactly at the bound refuses a homography, and not a fundamental matrix.
        ambiguous = second >= most if planar else second > most
        # The sources give no reasons; these follow the list of this project. The number of good points
        # comes first, since a few points have no reliable parallax.
        limits = (
            Limit("good", good, needed, good < self.min_triangulated, Verdict.NO_CONSISTENT_MOTION),
            Limit("parallax_deg", parallax, low, parallax < low, Verdict.LOW_PARALLAX),
            Limit("good", good, needed, good < needed, Verdict.NO_CONSISTENT_MOTION),
            Limit("second_share", second, most, ambiguous, Verdict.AMBIGUOUS_PLANE),
        )
        return pair.decided(check, best, planar, evidence | {"inliers": count}, limits)


def orb_slam3() -> OrbSlam:
    """Make the method with the rules of ORB-SLAM3 v1.0."""
    return OrbSlam(PairRule(min_features=101, min_matches=100, min_landmarks=50), homography_score_share=0.50)


def orb_slam2() -> OrbSlam:
    """Make the method with the rules of ORB-SLAM2."""
    return OrbSlam(PairRule(min_features=101, min_matches=100, min_landmarks=100), homography_score_share=0.40)


def _highest(models: Floats, errors: tuple[Floats, Floats], gate: float, full: float) -> tuple[Floats, float, Bools]:
    """Return the model (3, 3) of the highest score, the score, and the matches (N,) within the gate in both images."""
    within = [error <= gate for error in errors]  # False for NaN
    score = sum(np.where(ok, full - error, 0.0).sum(axis=1) for ok, error in zip(within, errors, strict=True))
    best = int(np.argmax(score))
    return models[best], float(score[best]), within[0][best] & within[1][best]


@dataclass(frozen=True)
class Stella(RuledMethod):
    """The initialization of stella_vslam as a two-view method. Each constant has its source.

    Departures from the sources: the random generator, and a point may be reprojected outside of the image.
    """

    #: The reference is replaced if there are fewer matches [6]_; the landmarks are those below.
    pair_rule: ClassVar[PairRule] = PairRule(min_features=50, min_matches=50, min_landmarks=50)
    #: Matches in a sample for F, and for H.
    fewest: ClassVar[int] = 8
    homography_sample: ClassVar[int] = 4

    #: Number of samples for each model; the two models have separate samples [4]_ [6]_.
    iterations: int = 100
    #: Largest cost of a match: 95 % of chi-square with two degrees of freedom, at a noise of one pixel [4]_.
    gate_px2: float = 5.991
    #: The homography is taken if its share of the sum of both costs is smaller [5]_.
    homography_cost_share: float = 0.5
    #: min_valid, min_triangulated: Required number of points that count for the motion, and of those that have a
    #: depth [6]_.
    min_valid: int = 50
    min_triangulated: int = 50
    #: No second motion may have more than this share of the points of the best motion [5]_.
    second_share: float = 0.8
    #: The 51st largest parallax has to be larger [5]_ [6]_.
    min_parallax_deg: float = 1.0
    #: A homography has no motion if the ratio of two of its singular values is nearer to one [4]_.
    singular_ratio: float = 1.0001
    #: Reprojection errors within 4 px [6]_. A point is at infinity if the cosine of its parallax is larger, which is
    #: half a degree [5]_. Triangulation by midpoints.
    check: ClassVar[CheckRule] = CheckRule(max_error_px=4.0, distant_cos=0.99996192306, midpoint=True)

    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair."""
        pixels, rng, bound = (pair.pixels1, pair.pixels2), np.random.default_rng(pair.seed), self.homography_cost_share
        samples_H, samples_F = (
            draw_samples(rng, len(pair), size, self.iterations) for size in (self.homography_sample, self.fewest)
        )
        H, F = homographies(*pixels, samples_H), fundamentals(*pixels, samples_F)
        # NaN (a point that is mapped to infinity) is not an inlier.
        H, cost_H, inliers_H = self._cheapest(H, np.maximum(*transfer_errors(H, *pixels)))
        F, cost_F, inliers_F = self._cheapest(F, sampson_errors(F, *pixels))
        share = cost_H / (cost_H + cost_F) if cost_H + cost_F > 0 else bound
        planar = share < bound
        evidence: Evidence = {"homography_cost_share": share, "homography_cost_share_gate": bound}
        R, t = pair.motions(H if planar else F, planar, self.singular_ratio)
        if len(R) == 0:
            return pair.refused(Verdict.PURE_ROTATION, evidence)
        check = pair.check(R, t, inliers_H if planar else inliers_F, self.check)
        best, valid, parallax = check.best()
        second, found = check.second_share(), int(check.landmarks[best].sum())
        few, low, most, least = self.min_valid, self.min_parallax_deg, self.second_share, self.min_triangulated
        # The sources give no reasons. Too few points have no reliable parallax, so they are tested first. The other
        # reasons follow the list of this project.
        limits = (
            Limit("good", valid, few, valid < few, Verdict.NO_CONSISTENT_MOTION),
            Limit("parallax_deg", parallax, low, parallax < low, Verdict.LOW_PARALLAX),
            Limit("second_share", second, most, second > most, Verdict.AMBIGUOUS_PLANE),
            Limit("triangulated", found, least, found < least, Verdict.TOO_FEW_LANDMARKS),
        )
        return pair.decided(check, best, planar, evidence, limits)

    def _cheapest(self, models: Floats, errors: Floats) -> tuple[Floats, float, Bools]:
        """Return the model (3, 3) of least truncated cost, the cost, and the matches (N,) within the gate."""
        cost = np.fmin(errors, self.gate_px2).sum(axis=1)
        best = int(np.argmin(cost))
        return models[best], float(cost[best]), errors[best] < self.gate_px2
