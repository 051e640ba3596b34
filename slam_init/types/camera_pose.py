"""The pose of the newest camera, from the second frame on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from slam_init.types.arrays import Floats


class PoseKind(StrEnum):
    """What is known of a pose."""

    ROTATION = "rotation"
    PROVISIONAL = "provisional"
    MAP = "map"


@dataclass(frozen=True, eq=False)
class CameraPose:
    """The pose of the newest camera: enough to render or to stabilize with while the initialization goes on.

    Attributes
    ----------
    kind : PoseKind
        ``rotation``: the tracks show no translation, and points count as far away. ``provisional``: the best motion of
        the last window, which may still be wrong (:attr:`slam_init.types.status.Status.risk`). ``map``: located in
        the accepted map.
    cam_from_first : (3, 3) float
        Rotation from the axes of the first camera to those of this one. Where no tracks link a map to the first camera,
        as after a cut, ``reference`` is the first one.
    rotation_sigma_deg : float
        Standard deviation of the rotation where it is largest. For ``rotation`` it allows for the parallax that a
        rotation takes up, for ``provisional`` for rivals of the motion. It does not know that a sideways motion before
        a distant plane looks like a rotation.
    centre : (3,) float or None
        Centre of this camera from that of ``reference``, in the axes of the first camera. Its unit is that of the map,
        or the baseline of the pair of the window; None for ``rotation``.
    direction_sigma_deg : float or None
        Standard deviation of the direction of the pair's baseline where it is largest.
    reference : int or None
        Absolute index of the frame whose centre is the origin.
    """

    kind: PoseKind
    cam_from_first: Floats
    rotation_sigma_deg: float
    centre: Floats | None = None
    direction_sigma_deg: float | None = None
    reference: int | None = None
