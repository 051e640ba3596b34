"""The scale of a map: metres for a unit of the map, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from quest.display import Described
from slam_init.types.inertial import Gravity


class ScaleOrigin(StrEnum):
    """Where a scale comes from."""

    MARKER = "marker"
    BOARD = "board"
    HEIGHT = "height"
    DISTANCE = "distance"
    GROUNDTRUTH = "groundtruth"
    IMU = "imu"


@dataclass(frozen=True, repr=False)
class Scale(Described):
    """How long the unit of a map is. Truthy when it was found.

    A map without a scale has the median depth of its landmarks as unit. The factor is that of such a map, also once the
    map itself is in metres.
    """

    #: Where the scale comes from.
    origin: ScaleOrigin
    #: Factor from units of the map to metres; None where no scale was found.
    metres_per_unit: float | None = None
    #: Relative standard deviation of the factor: 0.02 is two per cent. It holds for the distance from the first camera
    #: to the one farthest from it, and includes the stated deviation of the known length. None where no scale was
    #: found.
    sigma: float | None = None
    #: What the scale was found from, in words: the sightings, the plane or the frames.
    evidence: str = ""
    #: Why no scale was found; empty where one was.
    reason: str = ""
    #: In the world of the map, where an inertial sensor measures it.
    gravity: Gravity | None = None

    def __bool__(self) -> bool:
        return self.metres_per_unit is not None

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        if self.metres_per_unit is None or self.sigma is None:
            return f"no scale from {self.origin}", [("reason", self.reason)]
        return f"{self.metres_per_unit:.4g} m for a unit, +- {self.sigma:.1%}, from {self.origin}", [
            ("evidence", self.evidence),
            *([] if self.gravity is None else [("gravity", str(self.gravity))]),
        ]
