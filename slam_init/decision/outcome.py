"""The end of an attempt."""

from __future__ import annotations

from dataclasses import dataclass

from slam_init.mapping.map_building import MapWithViews
from slam_init.types.comparison import Margin
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

__all__ = ["Outcome"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of an attempt: its verdict, and the maps that it leaves.

    Attributes
    ----------
    attempt : Attempt
        The verdict and its evidence.
    accepted : MapWithViews or None
        A map that passed all gates.
    hypotheses : tuple of InitialMap
        The maps of two motions that the tracks do not decide between, the better one first.
    margin : Margin or None
        The vote between the best motion and its nearest rival; None without a rival.
    """

    attempt: Attempt
    accepted: MapWithViews | None = None
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None
