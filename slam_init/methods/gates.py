"""Cheirality and parallax: what every estimator of a single essential matrix needs before its pose is a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.methods.motions import IN_FRONT, MotionCheck, check_motions
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera

__all__ = ["GATED_PAIRS", "GateRules", "accept_best"]


@dataclass(frozen=True)
class GateRules:
    """What the best motion has to show. The numbers are those that ORB-SLAM and stella_vslam share."""

    #: Points in front of both cameras.
    min_in_front: int = 50
    #: Degrees that the 51st largest parallax exceeds.
    min_parallax_deg: float = 1.0


#: The pairs that these estimators are shown: those of ORB-SLAM, so that the methods see the same ones. As many
#: landmarks have to be left as points in front were asked for.
GATED_PAIRS = PairRule(min_features=101, min_matches=100, min_landmarks=50)


def accept_best(
    camera: Camera,
    R: Floats,
    t: Floats,
    bearings1: Floats,
    bearings2: Floats,
    inliers: Bools,
    rules: GateRules,
    evidence: Evidence,
) -> TwoViewOutcome:
    """The motion, of K, that puts most inliers in front of both cameras, if it passes the gates.

    Parameters
    ----------
    camera : Camera
    R : (K, 3, 3) float
    t : (K, 3) float
    bearings1, bearings2 : (N, 3) float
    inliers : (N,) bool
    rules : GateRules
    evidence : dict
        What is known already.
    """
    count = len(inliers)
    check: MotionCheck = check_motions(camera, R, t, bearings1, bearings2, inliers, IN_FRONT)
    in_front = check.good.sum(axis=1)
    best = int(np.argmax(in_front))
    parallax_deg = float(check.parallax_deg[best])
    evidence = evidence | {"inliers": int(inliers.sum())}
    evidence |= {"in_front": int(in_front[best]), "in_front_gate": rules.min_in_front}
    evidence |= {"parallax_deg": parallax_deg, "parallax_deg_gate": rules.min_parallax_deg}
    if in_front[best] < rules.min_in_front:
        return TwoViewOutcome.refused("no_consistent_motion", count, evidence)
    if parallax_deg <= rules.min_parallax_deg:
        return TwoViewOutcome.refused("low_parallax", count, evidence)
    return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], False, evidence)
