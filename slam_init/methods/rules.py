"""What the methods of other systems have in common: the matches that they get, and their limits on a motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from slam_init.methods.motions import CheckRule, MotionCheck, check_motions, motions_of_essential, motions_of_homography
from slam_init.methods.two_view import Evidence, TwoViewOutcome, check_matches
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.refusal import Verdict


class Limit(NamedTuple):
    """A limit that a method sets on a motion."""

    #: Name of the figure in the evidence; the bound has the name with ``_gate``.
    name: str
    value: float
    bound: float
    #: Whether the figure refuses the pair.
    refuses: bool
    reason: Verdict


@dataclass(frozen=True, eq=False)
class Pair:
    """The matches of a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""

    camera: Camera
    pixels1: Floats
    pixels2: Floats
    rays1: Floats
    rays2: Floats
    seed: int

    def __len__(self) -> int:
        return len(self.pixels1)

    def motions(self, model: Floats, planar: bool, singular_ratio: float) -> tuple[Floats, Floats]:
        """Compute the motions of a homography, or of a fundamental matrix, of the pixels.

        Shapes: ``model`` (3, 3), returns ``R`` (K, 3, 3), returns ``t`` (K, 3).
        """
        K = self.camera.K
        if not planar:
            return motions_of_essential(K.T @ model @ K)
        R, t, _ = motions_of_homography(np.linalg.inv(K) @ model @ K, singular_ratio)
        return R, t

    def check(self, R: Floats, t: Floats, inliers: Bools, rule: CheckRule) -> MotionCheck:
        """Triangulate the inliers with each motion; see :func:`slam_init.methods.motions.check_motions`."""
        return check_motions(self.camera, R, t, self.rays1, self.rays2, inliers, rule)

    def refused(self, reason: Verdict, evidence: Evidence | None = None) -> TwoViewOutcome:
        """Refuse the pair."""
        return TwoViewOutcome.refused(reason, len(self), evidence)

    def decided(
        self, check: MotionCheck, k: int, planar: bool, evidence: Evidence, limits: tuple[Limit, ...]
    ) -> TwoViewOutcome:
        """Accept a checked motion, or refuse the pair by the first limit that it misses."""
        evidence = evidence | {key: v for one in limits for key, v in _figures(one)}
        for limit in limits:
            if limit.refuses:
                return self.refused(limit.reason, evidence)
        return TwoViewOutcome.accepted(check.pose(k), check.landmarks[k], check.points[k], planar, evidence)


def _figures(limit: Limit) -> tuple[tuple[str, float], ...]:
    return (limit.name, limit.value), (f"{limit.name}_gate", limit.bound)


class RuledMethod(ABC):
    """A two-view method by the published rules of a system. The constants of the rules are its fields."""

    #: Smallest number of matches that have a model. Five matches have up to ten motions, and a sixth match chooses
    #: among them.
    fewest: ClassVar[int] = 6

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        count = check_matches(pixels1, pixels2, bearings1, bearings2)
        if count < self.fewest:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": self.fewest})
        return self.decide(Pair(camera, pixels1, pixels2, bearings1, bearings2, seed))

    @abstractmethod
    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair of enough matches."""
