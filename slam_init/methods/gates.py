"""Gates on cheirality and parallax, shared by the methods that estimate one essential matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.methods.motions import IN_FRONT, MotionCheck, check_motions
from slam_init.methods.two_view import Evidence, PairRule, TwoViewOutcome
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class GateRules:
    """The requirements on the best motion. ORB-SLAM and stella_vslam use the same numbers."""

    #: Smallest number of points in front of both cameras.
    min_in_front: int = 50
    #: The 51st largest parallax has to be larger.
    min_parallax_deg: float = 1.0


#: The pair rule of these methods. It is that of ORB-SLAM, so that the methods are compared on the same pairs. As many
#: landmarks are required after bundle adjustment as points in front before it.
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
    """Accept the motion that puts most inliers in front of both cameras, if it passes the gates.

    Shapes: ``R`` (K, 3, 3), ``t`` (K, 3), ``bearings1, bearings2`` (N, 3), ``inliers`` (N,).
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
        return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count, evidence)
    if parallax_deg <= rules.min_parallax_deg:
        return TwoViewOutcome.refused(Verdict.LOW_PARALLAX, count, evidence)
    return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], False, evidence)
