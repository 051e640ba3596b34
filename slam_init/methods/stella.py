"""The rules of stella_vslam: homography or fundamental matrix by the lower truncated cost, then one distinct motion.

References
----------
.. [1] stella_vslam, ``solve/homography_solver.cc``, ``solve/fundamental_solver.cc``.
.. [2] stella_vslam, ``initialize/perspective.cc``, ``initialize/base.cc``.
.. [3] stella_vslam, ``module/initializer.cc``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quest.robust.samples import draw_samples
from slam_init.methods.models import (
    fundamental_eight_point,
    homography_dlt,
    normalize,
    normalizing_transform,
    sampson_errors,
    transfer_errors,
)
from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class StellaRules:
    """The constants of the rules, each with its source."""

    #: Number of samples for each model; the two models have separate samples [1]_ [3]_.
    iterations: int = 100
    #: homography_sample, fundamental_sample: Matches in a sample for H and for F.
    homography_sample: int = 4
    fundamental_sample: int = 8
    #: Largest cost of a match: 95 % of chi-square with two degrees of freedom, at a noise of one pixel [1]_.
    gate_px2: float = 5.991
    #: The homography is taken if its share of the sum of both costs is smaller [2]_.
    homography_cost_share: float = 0.5
    #: min_valid, min_triangulated: Required number of points that count for the motion, and of those that have a
    #: depth [3]_.
    min_valid: int = 50
    min_triangulated: int = 50
    #: No second motion may have more than this share of the points of the best motion [2]_.
    rival_share: float = 0.8
    #: The 51st largest parallax has to be larger [2]_ [3]_.
    min_parallax_deg: float = 1.0
    #: A homography has no motion if the ratio of two of its singular values is nearer to one [1]_.
    singular_ratio: float = 1.0001
    #: Reprojection errors within 4 px [3]_. A point is at infinity if the cosine of its parallax is larger, which is
    #: half a degree [2]_. Triangulation by midpoints.
    check: CheckRule = field(
        default_factory=lambda: CheckRule(max_error_px=4.0, distant_cos=0.99996192306, midpoint=True)
    )
    #: The reference is replaced if there are fewer matches [3]_.
    min_matches: int = 50


class Stella:
    """The initialization of stella_vslam as a two-view method.

    Departures from the sources: the random generator, and a point may be reprojected outside of the image.
    """

    def __init__(self, rules: StellaRules | None = None) -> None:
        self.rules = rules or StellaRules()
        self.pair_rule = PairRule(self.rules.min_matches, self.rules.min_matches, self.rules.min_triangulated)

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.fundamental_sample:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.fundamental_sample})
        H, cost_H, inliers_H, F, cost_F, inliers_F = self._models(pixels1, pixels2, seed)
        share = cost_H / (cost_H + cost_F) if cost_H + cost_F > 0 else rules.homography_cost_share
        planar = share < rules.homography_cost_share
        evidence: Evidence = {"homography_cost_share": share, "homography_cost_share_gate": rules.homography_cost_share}
        if planar:
            R, t, _ = motions_of_homography(np.linalg.inv(camera.K) @ H @ camera.K, rules.singular_ratio)
        else:
            R, t = motions_of_essential(camera.K.T @ F @ camera.K)
        if len(R) == 0:
            return TwoViewOutcome.refused(Verdict.PURE_ROTATION, count, evidence)
        inliers = inliers_H if planar else inliers_F
        check = check_motions(camera, R, t, bearings1, bearings2, inliers, rules.check)
        valid, triangulated = check.good.sum(axis=1), check.landmarks.sum(axis=1)
        best = int(np.argmax(valid))
        rival = float(np.delete(valid, best).max() / max(valid[best], 1))
        parallax_deg = float(check.parallax_deg[best])
        evidence |= {"good": int(valid[best]), "good_gate": rules.min_valid}
        evidence |= {"rival_share": rival, "rival_share_gate": rules.rival_share}
        evidence |= {"parallax_deg": parallax_deg, "parallax_deg_gate": rules.min_parallax_deg}
        evidence |= {"triangulated": int(triangulated[best]), "triangulated_gate": rules.min_triangulated}
        # The sources give no reasons. Too few points have no reliable parallax, so they are tested first. The other
        # reasons follow the list of this project.
        if valid[best] < rules.min_valid:
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
        if parallax_deg < rules.min_parallax_deg:
            return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
        if rival > rules.rival_share:
            return TwoViewOutcome.refused(Verdict.AMBIGUOUS_PLANE, count, evidence)
        if triangulated[best] < rules.min_triangulated:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_LANDMARKS, count, evidence)
        return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], planar, evidence)

    def _models(self, pixels1: Floats, pixels2: Floats, seed: int) -> tuple[Floats, float, Bools, Floats, float, Bools]:
        """Estimate H and F of least cost, each with its cost and its inliers."""
        rules, rng = self.rules, np.random.default_rng(seed)
        T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
        x1, x2 = normalize(T1, pixels1), normalize(T2, pixels2)
        drawn = draw_samples(rng, len(pixels1), rules.homography_sample, rules.iterations)
        models = np.linalg.inv(T2) @ homography_dlt(x1[drawn], x2[drawn]) @ T1
        # NaN (a point that is mapped to infinity) is not an inlier.
        errors = np.maximum(*transfer_errors(models, pixels1, pixels2))
        H, cost_H, inliers_H = _cheapest(models, errors, rules.gate_px2)
        drawn = draw_samples(rng, len(pixels1), rules.fundamental_sample, rules.iterations)
        models = T2.T @ fundamental_eight_point(x1[drawn], x2[drawn]) @ T1
        F, cost_F, inliers_F = _cheapest(models, sampson_errors(models, pixels1, pixels2), rules.gate_px2)
        return H, cost_H, inliers_H, F, cost_F, inliers_F


def _cheapest(models: Floats, errors: Floats, gate: float) -> tuple[Floats, float, Bools]:
    """Return the model (3, 3) of least truncated cost, the cost, and the matches (N,) within the gate."""
    cost = np.fmin(errors, gate).sum(axis=1)
    best = int(np.argmin(cost))
    return models[best], float(cost[best]), errors[best] < gate
