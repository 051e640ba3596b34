"""The end of an attempt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slam_init.types.evidence import Margin
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

if TYPE_CHECKING:
    from slam_init.decision.pose_so_far import WindowMotion
    from slam_init.mapping.map_building import MapWithViews
    from slam_init.types.lens_in_use import LensInUse


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
    #: The poses of the cameras of the judged window; None where no window was judged.
    motion: WindowMotion | None = None
    #: The lens to go on with; None where no window was judged.
    lens: LensInUse | None = None
