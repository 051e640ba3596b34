"""The results of an estimate: a relative pose with its alternatives and evidence, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.display import Described
from quest.errors import InputError, as_floats
from quest.uncertainty.parallax import ParallaxStatement

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Median parallax in deviations of the noise from which the covariance holds: baselines of .01 of the depth have 6, of
#: .03 have 16.
_LEAST_PARALLAX_SIGMAS = 10.0


@dataclass(frozen=True)
class PoseEvidence:
    """The numbers on which the decisions of an estimate rest.

    A field is None where the estimate ended before the number was needed.

    Attributes
    ----------
    matches : int
        Number of matches; where the reason is "too_few_matches", the number of distinct matches.
    needed : int or None
        Smallest number of distinct matches; given where the reason is "too_few_matches".
    samples : int or None
        Number of samples that RANSAC drew.
    inliers : int or None
        Number of matches that the best motion of RANSAC explains after refinement.
    noise_rad : float or None
        Standard deviation of a bearing, from the residuals of these inliers.
    chance_inliers : float or None
        Mean number of matches that this motion explains after the matches are shuffled.
    false_alarms : float or None
        Expected number of motions that explain as many matches by chance, over all samples and gates (for kind
        "rotation" that of rotations). A motion counts up to 0.1, a rotation up to 0.001.
    parallax_z : float or None
        Test value of the translation, see :attr:`quest.ParallaxStatement.test_value`.
    parallax_p : float or None
        Bound on the probability of such matches without a translation, see :attr:`quest.ParallaxStatement.p_value`.
    rotation_inliers : int or None
        Number of matches that a rotation alone explains; given where no translation is observable.
    off_line_rad : float or None
        Distance of the rays from their best great circle; given where the points lie on a line.
    on_plane, off_plane : int or None
        Number of inliers that lie on the best plane, and number of inliers that do not.
    """

    matches: int
    needed: int | None = None
    samples: int | None = None
    inliers: int | None = None
    noise_rad: float | None = None
    chance_inliers: float | None = None
    false_alarms: float | None = None
    parallax_z: float | None = None
    parallax_p: float | None = None
    rotation_inliers: int | None = None
    off_line_rad: float | None = None
    on_plane: int | None = None
    off_plane: int | None = None

    def as_dict(self) -> dict[str, float]:
        """The known numbers by name, in the order of the fields.

        Returns
        -------
        dict of str to float
            Without the fields that are None.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    def extended(self, **more: float) -> PoseEvidence:
        """The same with further numbers.

        Parameters
        ----------
        **more : float
            Attributes of this class with their values.

        Returns
        -------
        PoseEvidence
            A new one with these values.
        """
        # ``dataclasses.replace`` takes six times as long.
        return PoseEvidence(**{**vars(self), **more})


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One motion: ``u R m + t = v n`` with |t| = 1.

    Attributes
    ----------
    q_wxyz : (4,) float
        Unit quaternion of R, w >= 0.
    R : (3, 3) float
        Rotation of cam2_from_cam1.
    t : (3,) float
        Translation of cam2_from_cam1, unit norm.
    inliers : (N,) bool
        The matches that the motion explains, in front of both cameras.
    """

    q_wxyz: Floats
    R: Floats
    t: Floats
    inliers: Bools


@dataclass(frozen=True, eq=False, repr=False)
class RelativePose(Described, Hypothesis):
    """A relative pose, ``cam2_from_cam1``, its uncertainty and its alternatives. Truthy.

    Attributes
    ----------
    q_wxyz : (4,) float
        Unit quaternion of R, w >= 0.
    R : (3, 3) float
        Rotation of cam2_from_cam1.
    t : (3,) float
        Translation of cam2_from_cam1, unit norm; zero where ``kind`` is "rotation".
    inliers : (N,) bool
        The matches that the pose explains, in front of both cameras.
    depths1, depths2 : (N,) float
        Depths along the unit bearings, in units of |t|; NaN where a match is no inlier and for kind "rotation".
    kind : str
        "general", "planar" (one plane explains the inliers) or "rotation" (no translation is observable).
    alternatives : tuple of Hypothesis
        Other poses that explain the matches as well: at most three, on a plane at most one. For kind "rotation" they
        are motions with a translation that the matches do not show; further views may.
    noise_rad : float
        Standard deviation of a bearing, estimated from the residuals of the inliers.
    parallax_rad : float
        Median over the inliers of the angle between the two rays of a match, after the rotation is removed.
    parallax : ParallaxStatement or None
        Whether there is a translation at all: |t|/depth = a +- b, and the probability of such matches without one.
        None where RANSAC found no motion to test (exact rotations).
    covariance : (5, 5) float
        Covariance in rad^2, from the noise of the residuals; NaN for kind "rotation". The first three unknowns are a
        rotation vector applied to R from the left, the last two are coordinates of t in the basis
        ``quest.geometry.epipolar.tangent_basis(t)``.
    evidence : PoseEvidence
        The numbers on which the decisions rest.
    H : (3, 3) float or None
        Homography ``R + t k'`` of the plane ``k . X = 1`` for kind "planar", R for kind "rotation": n is parallel to
        H m for the bearings of a match, and ``K2 H K1^-1`` is that of pixels. None for kind "general".
    """

    depths1: Floats
    depths2: Floats
    kind: str
    alternatives: tuple[Hypothesis, ...]
    noise_rad: float
    parallax_rad: float
    parallax: ParallaxStatement | None
    covariance: Floats
    evidence: PoseEvidence
    H: Floats | None = None

    def __bool__(self) -> bool:
        return True

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        angle_deg = float(np.degrees(2 * np.arccos(min(1.0, abs(float(self.q_wxyz[0]))))))
        facts = [("rotation", f"{angle_deg:.3g} deg, q_wxyz {np.array2string(self.q_wxyz, precision=4)}")]
        if self.kind != "rotation":
            sigma_deg = np.degrees(self.direction_sigma_rad)
            facts.append(("direction", f"{np.array2string(self.t, precision=4)} +- {sigma_deg:.2g} deg"))
            facts.append(("parallax", f"{np.degrees(self.parallax_rad):.3g} deg (median)"))
        facts.append(("noise", f"{self.noise_rad:.2g} rad"))
        others = f", {len(self.alternatives)} more explain the matches as well" if self.alternatives else ""
        return f"{self.kind} pose, {self.inliers.sum()} inliers of {len(self.inliers)} matches{others}", facts

    @property
    def E(self) -> Floats:
        """Essential matrix ``[t]x R``: ``n . E m = 0`` for the bearings of a match; zero for kind "rotation".

        Returns
        -------
        (3, 3) float
        """
        return np.cross(self.t, self.R, axis=0)

    def fundamental_matrix(self, K1: ArrayLike, K2: ArrayLike | None = None) -> Floats:
        """Fundamental matrix: ``x2 . F x1 = 0`` for the homogeneous pixels of a match in two pinhole cameras.

        Parameters
        ----------
        K1, K2 : (3, 3) array_like
            Camera matrices; without K2 both views have K1.

        Returns
        -------
        (3, 3) float
            Of unit norm; zero for kind "rotation".

        Raises
        ------
        InputError
            If a camera matrix is not finite, not (3, 3) or singular.
        """
        first, second = (_inverse_of_camera(K) for K in (K1, K1 if K2 is None else K2))
        F = second.T @ self.E @ first
        norm = float(np.linalg.norm(F))
        return np.asarray(F / norm if norm > 0 else F)

    @property
    def covariance_holds(self) -> bool:
        """Whether the 95 % ellipsoid of the covariance is known to hold the truth in 92 % of the scenes or more.

        False where the median parallax is less than ten deviations of the noise: the parallax, by which the covariance
        follows, is then itself uncertain, and the ellipsoid held 84 to 94 %.

        Returns
        -------
        bool
            False for kind "rotation".
        """
        return bool(self.kind != "rotation" and self.parallax_rad >= _LEAST_PARALLAX_SIGMAS * self.noise_rad)

    @property
    def direction_sigma_rad(self) -> float:
        """Standard deviation of the direction of t along its least certain axis.

        Returns
        -------
        float
            Radians; infinite where ``covariance`` is not finite.
        """
        tangent = self.covariance[3:, 3:]
        return float(np.sqrt(np.linalg.eigvalsh(tangent)[-1])) if np.isfinite(tangent).all() else float("inf")


def _inverse_of_camera(K: ArrayLike) -> Floats:
    matrix = as_floats(K, "the camera matrix")
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 3:
        raise InputError(f"the camera matrix has shape {matrix.shape}: give a finite regular matrix (3, 3)")
    return np.asarray(np.linalg.inv(matrix))


@dataclass(frozen=True, eq=False, repr=False)
class NoPose(Described):
    """The estimate found no pose. Falsy.

    Attributes
    ----------
    reason : str
        "too_few_matches" (fewer than ten distinct ones) or "no_consistent_motion" (no motion explains more matches than
        chance would, or the points lie on a line, so that a family of motions explains them).
    evidence : PoseEvidence
        The numbers behind the decision.
    """

    reason: str
    evidence: PoseEvidence

    def __bool__(self) -> bool:
        return False

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        facts = [(name.replace("_", " "), f"{value:.4g}") for name, value in self.evidence.as_dict().items()]
        return f"no pose: {self.reason}", facts[:5]
