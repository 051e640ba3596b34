"""The interface of a two-view method: it accepts a motion for the matches of one pair, or refuses the pair.

:class:`RuledMethod` is the base of the methods of other systems.

The frames, the tracks and the bundle adjustment of :class:`slam_init.methods.pair_initializer.PairInitializer` are the
same for all methods, so that a comparison shows differences between the methods only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.methods.motions import CheckRule, MotionCheck, check_motions, motions_of_essential, motions_of_homography
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.types.refusal import REASONS, Verdict

#: The figures behind the decision of a method, under the method's own names. They are only reported.
Evidence = dict[str, float | int | str]


@dataclass(frozen=True)
class PairRule:
    """The choice of pairs: a reference is paired with each later frame, until too few of its tracks are left.

    Attributes
    ----------
    min_features : int
        Smallest number of features of a reference, and of a frame that is paired with it.
    min_matches : int
        Smallest number of common tracks. If there are fewer, the current frame becomes the new reference.
    min_landmarks : int
        Smallest number of landmarks after bundle adjustment.
    """

    min_features: int
    min_matches: int
    min_landmarks: int


@dataclass(frozen=True, eq=False)
class TwoViewOutcome:
    """The decision of a method on one pair. Truthy when the pair is accepted.

    Attributes
    ----------
    reason : str
        ``accepted`` or a reason of :data:`slam_init.types.refusal.REASONS`.
    cam2_from_cam1 : Pose or None
        ``u R m + t = v n`` with |t| = 1; None if the pair is refused.
    landmarks : (N,) bool
        The matches that become points of the map.
    points : (N, 3) float
        In the frame of camera 1, in units of the baseline; NaN for matches that are not landmarks.
    planar : bool
        Whether the motion comes from a homography.
    evidence : dict
        The numbers behind the decision, with their thresholds.
    """

    reason: str
    cam2_from_cam1: Pose | None
    landmarks: Bools
    points: Floats
    planar: bool = False
    evidence: Evidence = field(default_factory=dict)

    def __bool__(self) -> bool:
        return self.cam2_from_cam1 is not None

    @property
    def verdict(self) -> Verdict:
        """The reason as a verdict of the pipeline; it is an error if it is none of them."""
        try:
            return Verdict(self.reason)
        except ValueError:
            known = ", ".join(REASONS)
            raise SlamInitError(f"a method gave the unknown reason {self.reason!r}: use one of {known}") from None

    @staticmethod
    def refused(reason: str, count: int, evidence: Evidence | None = None) -> TwoViewOutcome:
        """Make the outcome of a refused pair.

        Parameters
        ----------
        reason : str
            A reason of :data:`slam_init.types.refusal.REASONS`.
        count : int
            Number of matches.
        evidence : dict, optional
            The numbers behind the decision, with their thresholds.

        Returns
        -------
        TwoViewOutcome
        """
        return TwoViewOutcome(reason, None, np.zeros(count, bool), np.full((count, 3), np.nan), False, evidence or {})

    @staticmethod
    def accepted(
        cam2_from_cam1: Pose, landmarks: Bools, points: Floats, planar: bool, evidence: Evidence
    ) -> TwoViewOutcome:
        """Make the outcome of an accepted pair.

        Parameters
        ----------
        cam2_from_cam1 : Pose
            ``u R m + t = v n`` with |t| = 1.
        landmarks : (N,) bool
            The matches that become points of the map.
        points : (N, 3) float
            In the frame of camera 1, in units of the baseline.
        planar : bool
            Whether the motion comes from a homography.
        evidence : dict
            The numbers behind the decision, with their thresholds.

        Returns
        -------
        TwoViewOutcome
        """
        kept = np.where(landmarks[:, None], points, np.nan)
        return TwoViewOutcome(Verdict.ACCEPTED, cam2_from_cam1, landmarks, kept, planar, evidence)


class TwoViewMethod(Protocol):
    """A method that initializes from two views."""

    @property
    def pair_rule(self) -> PairRule:
        """The choice of the pairs that the method gets."""

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept a motion between two views, or refuse the pair.

        Parameters
        ----------
        camera : Camera
            Its ``K`` is the camera matrix of the undistorted pixels.
        pixels1, pixels2 : (N, 2) float
            Matched pixels, undistorted (see :func:`undistorted_pixels`).
        bearings1, bearings2 : (N, 3) float
            Unit rays of the same matches.
        seed : int
            Seed of all random draws.

        Returns
        -------
        TwoViewOutcome

        Raises
        ------
        SlamInitError
            If the shapes of the arrays do not fit together, or a number is not finite.
        """


def undistorted_pixels(camera: Camera, bearings: Floats) -> Floats:
    """Project rays with the camera matrix of a camera, without its distortion: ``bearings`` (N, 3), returns (N, 2)."""
    K = camera.K
    return np.asarray(bearings[:, :2] / bearings[:, 2:] * (K[0, 0], K[1, 1]) + (camera.cx, camera.cy))


def check_matches(pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats) -> int:
    """Check the arrays that a method gets: ``pixels1, pixels2`` (N, 2), ``bearings1, bearings2`` (N, 3)."""
    count = len(pixels1)
    shapes = (pixels1.shape, pixels2.shape, bearings1.shape, bearings2.shape)
    if shapes != ((count, 2), (count, 2), (count, 3), (count, 3)):
        raise SlamInitError(f"matches of shapes {shapes}: give pixels (N, 2) twice and bearings (N, 3) twice")
    if not all(np.isfinite(array).all() for array in (pixels1, pixels2, bearings1, bearings2)):
        raise SlamInitError("a match holds a number that is not finite: leave it out")
    return count


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
    """The matches of a pair; see :meth:`TwoViewMethod.bootstrap`."""

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
        return motions_of_homography(np.linalg.inv(K) @ model @ K, singular_ratio)

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
        for limit in limits:
            evidence |= {limit.name: limit.value, f"{limit.name}_gate": limit.bound}
        for limit in limits:
            if limit.refuses:
                return self.refused(limit.reason, evidence)
        return TwoViewOutcome.accepted(check.pose(k), check.landmarks[k], check.points[k], planar, evidence)


class RuledMethod(ABC):
    """A two-view method by the published rules of a system. The constants of the rules are its fields."""

    #: Smallest number of matches that have a model. Five matches have up to ten motions, and a sixth match chooses
    #: among them.
    fewest: ClassVar[int] = 6

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`TwoViewMethod.bootstrap`."""
        count = check_matches(pixels1, pixels2, bearings1, bearings2)
        if count < self.fewest:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": self.fewest})
        return self.decide(Pair(camera, pixels1, pixels2, bearings1, bearings2, seed))

    @abstractmethod
    def decide(self, pair: Pair) -> TwoViewOutcome:
        """Accept or refuse a pair of enough matches."""
