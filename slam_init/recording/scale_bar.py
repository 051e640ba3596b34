"""The scale in a recording: a bar of a round length in metres."""

from __future__ import annotations

import math
from typing import Any

from slam_init.types.scale import Scale

#: The entity of the bar.
SCALE_BAR = "world/scale"
_COLOR = (230, 230, 230)
#: Length of the bar in units of the map, at most: the median depth is 1.
_LONGEST = 0.25


def bar_metres(metres_per_unit: float) -> float:
    """Choose the length of the bar.

    * Returns: 1, 2 or 5 times a power of ten, at most a quarter of the unit.
    """
    most = _LONGEST * metres_per_unit
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= most * (1 + 1e-9))


def log_scale_bar(rec: Any, scale: Scale) -> None:
    """Log the bar from the first camera to the right, with its length and the scale as label."""
    import rerun as rr

    if scale.metres_per_unit is None or scale.sigma is None:
        return
    metres = bar_metres(scale.metres_per_unit)
    end = metres / scale.metres_per_unit
    label = f"{metres:g} m (1 unit = {scale.metres_per_unit:.4g} m +- {scale.sigma:.1%}, {scale.origin})"
    rec.log(
        SCALE_BAR,
        rr.LineStrips3D(
            [[(0.0, 0.0, 0.0), (end, 0.0, 0.0)]], colors=[_COLOR], radii=rr.Radius.ui_points(2.5), labels=[label]
        ),
    )
