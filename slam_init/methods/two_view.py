"""What a two-view method is: it looks at the matches of one pair and accepts a motion, or says why not.

Written once for all of them, so that a comparison differs in the method alone: the pair rule, the frames and the
bundle adjustment are those of :class:`slam_init.methods.pair_initializer.PairInitializer`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.types.reasons import REASONS, Verdict

__all__ = ["Evidence", "PairRule", "TwoViewMethod", "TwoViewOutcome", "check_matches", "undistorted_pixels"]

#: What a method tells about its decision: names of its own, which nothing in this project acts on.
Evidence = dict[str, float | int | str]


@dataclass(frozen=True)
class PairRule:
    """Which frames are paired: one reference with every later frame, until too few of its tracks are left.

    Attributes
    ----------
    min_features : int
        A reference has at least so many features, and so has the frame it is paired with.
    min_matches : int
        With fewer common tracks the current frame becomes the new reference.
    min_landmarks : int
        Landmarks that have to be left after bundle adjustment.
    """

    min_features: int
    min_matches: int
    min_landmarks: int


@dataclass(frozen=True, eq=False)
class TwoViewOutcome:
    """What a method makes of one pair. Truthy when it accepts.

    Attributes
    ----------
    reason : str
        ``accepted`` or a reason of :data:`slam_init.types.reasons.REASONS`.
    cam2_from_cam1 : Pose or None
        ``u R m + t = v n`` with |t| = 1; None where the pair is refused.
    landmarks : (N,) bool
        The matches that become points of the map.
    points : (N, 3) float
        In camera 1, in units of the baseline; NaN where there is no landmark.
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
        """The reason as a verdict of the pipeline.

        Raises
        ------
        SlamInitError
            Where a method gives a reason that is none of :data:`slam_init.types.reasons.REASONS`.
        """
        try:
            return Verdict(self.reason)
        except ValueError:
            known = ", ".join(REASONS)
            raise SlamInitError(f"a method gave the unknown reason {self.reason!r}: use one of {known}") from None

    @staticmethod
    def refused(reason: str, count: int, evidence: Evidence | None = None) -> TwoViewOutcome:
        """No motion from ``count`` matches, for a reason."""
        return TwoViewOutcome(reason, None, np.zeros(count, bool), np.full((count, 3), np.nan), False, evidence or {})

    @staticmethod
    def accepted(
        cam2_from_cam1: Pose, landmarks: Bools, points: Floats, planar: bool, evidence: Evidence
    ) -> TwoViewOutcome:
        """A motion, and the points that become landmarks."""
        kept = np.where(landmarks[:, None], points, np.nan)
        return TwoViewOutcome(Verdict.ACCEPTED, cam2_from_cam1, landmarks, kept, planar, evidence)


class TwoViewMethod(Protocol):
    """A way to initialize from two views."""

    @property
    def pair_rule(self) -> PairRule:
        """Which pairs it is shown."""
        ...

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept a motion between two views, or refuse the pair.

        Parameters
        ----------
        camera : Camera
            Its ``K`` belongs to the pixels.
        pixels1, pixels2 : (N, 2) float
            Matched pixels, undistorted (see :func:`undistorted_pixels`).
        bearings1, bearings2 : (N, 3) float
            Their unit rays.
        seed : int
            Of all random draws.

        Raises
        ------
        SlamInitError
            Where the arrays do not belong together or hold a number that is not finite.
        """
        ...


def undistorted_pixels(camera: Camera, bearings: Floats) -> Floats:
    """Pixels (N, 2) that a camera without distortion and with the same ``K`` would have seen the rays (N, 3) at."""
    return np.asarray(bearings[:, :2] / bearings[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def check_matches(pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats) -> int:
    """The number of matches.

    Raises
    ------
    SlamInitError
        Where the arrays do not belong together or hold a number that is not finite.
    """
    count = len(pixels1)
    shapes = (pixels1.shape, pixels2.shape, bearings1.shape, bearings2.shape)
    if shapes != ((count, 2), (count, 2), (count, 3), (count, 3)):
        raise SlamInitError(f"matches of shapes {shapes}: give pixels (N, 2) twice and bearings (N, 3) twice")
    if not all(np.isfinite(array).all() for array in (pixels1, pixels2, bearings1, bearings2)):
        raise SlamInitError("a match holds a number that is not finite: leave it out")
    return count
