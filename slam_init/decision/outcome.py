"""The end of an attempt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slam_init.types.evidence import Margin
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

if TYPE_CHECKING:
    from slam_init.mapping.map_building import MapWithViews


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of an attempt: its verdict, and the maps that it leaves."""

    #: The verdict and its evidence.
    attempt: Attempt
    #: A map that passed all gates.
    accepted: MapWithViews | None = None
    #: The maps of two motions that the tracks do not decide between, the better one first.
    hypotheses: tuple[InitialMap, ...] = ()
    #: The vote between the best motion and its nearest rival; None without a rival.
    margin: Margin | None = None
