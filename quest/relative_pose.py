"""What is known of the motion between two views: a pose, what else explains the matches, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from quest.uncertainty.parallax import ParallaxStatement

__all__ = ["Hypothesis", "NoPose", "RelativePose"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One motion: ``u R m + t = v n`` with |t| = 1.

    Attributes
    ----------
    q_wxyz : (4,) float
    R : (3, 3) float
    t : (3,) float
    inliers : (N,) bool
        The matches that it explains, in front of both cameras.
    """

    q_wxyz: Floats
    R: Floats
    t: Floats
    inliers: Bools


@dataclass(frozen=True, eq=False)
class RelativePose:
    """A relative pose, ``cam2_from_cam1``, and what is known about it. Truthy.

    Attributes
    ----------
    q_wxyz : (4,) float
        Unit quaternion, w >= 0.
    R : (3, 3) float
    t : (3,) float
        Unit norm; zero where ``kind`` is "rotation".
    inliers : (N,) bool
    depths1, depths2 : (N,) float
        Depths along the unit bearings, in units of |t|; NaN where a match is no inlier and for kind "rotation".
    kind : str
        "general", "planar" (one plane explains the inliers) or "rotation" (no translation is observable).
    alternatives : tuple of Hypothesis
        Other poses that explain the matches as well: at most three, on a plane at most one.
    noise_rad : float
        Standard deviation of a bearing as estimated from the residuals of the inliers.
    parallax_rad : float
        Median over the inliers of the angle between the two rays of a match, after the rotation is removed.
    parallax : ParallaxStatement or None
        Whether there is a translation at all: |t|/depth = a +- b, and the probability of such matches without one.
        None where no motion was there to test (exact rotations).
    covariance : (5, 5) float
        Of a rotation vector applied to R from the left and of t in the basis ``refine.tangent_basis(t)``, in rad^2,
        from the residuals' noise; NaN for kind "rotation".
    evidence : dict
        The counts behind the decisions.
    """

    q_wxyz: Floats
    R: Floats
    t: Floats
    inliers: Bools
    depths1: Floats
    depths2: Floats
    kind: str
    alternatives: tuple[Hypothesis, ...]
    noise_rad: float
    parallax_rad: float
    parallax: ParallaxStatement | None
    covariance: Floats
    evidence: dict[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return True

    @property
    def direction_sigma_rad(self) -> float:
        """Standard deviation of the direction of t where it is least certain."""
        tangent = self.covariance[3:, 3:]
        return float(np.sqrt(np.linalg.eigvalsh(tangent)[-1])) if np.isfinite(tangent).all() else float("inf")


@dataclass(frozen=True, eq=False)
class NoPose:
    """There is no pose. Falsy.

    Attributes
    ----------
    reason : str
        "too_few_matches" (fewer than ten distinct ones) or "no_consistent_motion" (no motion explains more matches than
        chance would, or the points lie on a line, so that a family of motions does).
    evidence : dict
    """

    reason: str
    evidence: dict[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return False
