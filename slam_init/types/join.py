"""The similarity that joins two maps, or the reason why they are not joined."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from quest.display import Described
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose
from slam_init.types.reasons import in_words


class NoJoin(StrEnum):
    """Why two maps are not joined, or a frame is not located."""

    NO_COMMON_PLACE = "no_common_place"
    AMBIGUOUS_PLACE = "ambiguous_place"
    SCALE_OPEN = "scale_open"

    @property
    def advice(self) -> str:
        """What would help."""
        return {
            NoJoin.NO_COMMON_PLACE: "chance explains as many matches: show the place from a nearer view",
            NoJoin.AMBIGUOUS_PLACE: "two similarities explain the matches, as with a repeated pattern: show more of "
            "the place",
            NoJoin.SCALE_OPEN: "the common points do not tell the scale: let the maps grow (--refine), or show more",
        }[self]


@dataclass(frozen=True, eq=False)
class Similarity:
    """``X_a = s R X_b + t``, named ``a_from_b``.

    Attributes
    ----------
    s : float
        Scale, positive.
    R : (3, 3) float
        Rotation matrix.
    t : (3,) float
        Translation, in the unit of a.
    """

    s: float
    R: Floats
    t: Floats

    def apply(self, points: Floats) -> Floats:
        """Transform points.

        Parameters
        ----------
        points : (..., 3) float
            In frame b.

        Returns
        -------
        (..., 3) float
            In frame a.
        """
        return self.s * points @ self.R.T + self.t

    def pose(self, world_from_cam: Pose) -> Pose:
        """Move a camera.

        Parameters
        ----------
        world_from_cam : Pose
            In the map b.

        Returns
        -------
        Pose
            The same camera in the map a, in the unit of a.
        """
        return Pose(self.R @ world_from_cam.R, self.apply(world_from_cam.t))

    def inverse(self) -> Similarity:
        """Invert the similarity.

        Returns
        -------
        Similarity
            ``b_from_a``.
        """
        return Similarity(1 / self.s, self.R.T, -self.R.T @ self.t / self.s)


@dataclass(frozen=True, eq=False, repr=False)
class Join(Described):
    """Whether two maps see the same place. Truthy when they are joined.

    Attributes
    ----------
    first_from_second : Similarity or None
        Brings the second map to the frame and the unit of the first. None where they are not joined.
    reason : NoJoin or None
        Why they are not joined.
    risk : float
        Expected number of similarities that explain as many matches by chance, at most 1.
    scale_sigma : float
        Relative standard deviation of the scale: by the noise of the rays, by what the fit moves when a view of either
        map is left out, and by the deviations of the depths that both maps state. Infinite where no
        similarity was found.
    matches : int
        Number of points with similar descriptors.
    inliers : int
        Number of these that the similarity explains.
    """

    first_from_second: Similarity | None
    reason: NoJoin | None
    risk: float
    scale_sigma: float
    matches: int
    inliers: int

    def __bool__(self) -> bool:
        return self.first_from_second is not None

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        matches = ("matches", f"{self.inliers} of {self.matches} agree, risk {self.risk:.2g} that by chance")
        if self.first_from_second is None:
            assert self.reason is not None
            return f"not joined: {in_words(self.reason)}", [matches, ("advice", self.reason.advice)]
        found = self.first_from_second
        angle = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(found.R)) - 1) / 2))))
        shift = ", ".join(f"{x:.4g}" for x in found.t)
        return "joined", [
            ("scale", f"{found.s:.5g} +- {self.scale_sigma:.2%}: units of the first map in one of the second"),
            ("moved by", f"a rotation of {angle:.2f} deg, and ({shift})"),
            matches,
        ]
