"""The place of a map, by which the map is found again: points with descriptors, and the views that see them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quest.display import Described
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.initial_map import Keyframe
from slam_init.types.unit_error import UnitError


@dataclass(frozen=True, eq=False, repr=False)
class Place(Described):
    """The SIFT points of a map, in its frame and unit. ``handover.npz`` holds one.

    Attributes
    ----------
    views : tuple of V Keyframe
        Views of the map, with poses that are held.
    points : (P, 3) float
        In the world frame of the map.
    descriptors : (P, 128) float
        RootSIFT of unit norm, the mean over the views.
    observation_views, observation_points : (M,) int
        Positions in ``views`` and in ``points``.
    observation_bearings : (M, 3) float
        Unit rays in the camera frame of the view.
    noise_rad : float
        Standard deviation of a ray in one direction.
    unit_error : UnitError
        That of the map (:attr:`InitialMap.unit_error`).
    lens : tuple of float
        fx, fy, cx, cy of the camera of the map, then the distortion.
    """

    views: tuple[Keyframe, ...]
    points: Floats
    descriptors: Floats
    observation_views: Ints
    observation_points: Ints
    observation_bearings: Floats
    noise_rad: float
    unit_error: UnitError = field(default_factory=UnitError)
    lens: tuple[float, ...] = ()

    @staticmethod
    def empty() -> Place:
        """Make a place that nothing is found by.

        Returns
        -------
        Place
        """
        none = np.zeros(0, np.int64)
        return Place((), np.zeros((0, 3)), np.zeros((0, 128)), none, none, np.zeros((0, 3)), 0.0)

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        frames = ", ".join(str(view.frame) for view in self.views)
        return f"place of {len(self.points)} points", [("views", f"frames {frames}")]


class Appearance(NamedTuple):
    """What the images of a map show of it, for ``handover.npz``."""

    #: (L, 32) ORB descriptors of the landmarks, and (L,) whether a landmark has one.
    orb: Image
    described: Bools
    place: Place
