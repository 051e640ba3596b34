"""Trajectories as lines of the recording: dashed, and those of maps that the views could not decide between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slam_init.recording.layout import Color
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap

__all__ = ["dashes", "log_hypotheses"]

#: The ground truth is dashed, so that the estimate is seen where both agree.
_DASHES = 30
#: The better of the two maps that are kept, and its rival.
_COLORS: tuple[Color, ...] = ((190, 120, 255), (130, 110, 150))


def dashes(positions: Floats) -> list[Floats]:
    """Every other piece of a path cut into pieces of one length."""
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    cuts = np.linspace(0, along[-1], 2 * _DASHES)
    dashes = []
    for begin, end in cuts.reshape(-1, 2):
        # The corners in between belong to a dash too.
        at = np.concatenate([[begin], along[(along > begin) & (along < end)], [end]])
        dashes.append(np.stack([np.interp(at, along, column) for column in positions.T], axis=1))
    return dashes


def log_hypotheses(rec: Any, maps: Sequence[InitialMap]) -> None:
    """Log the path of each map, the better one first, and clear those for which there is none.

    Parameters
    ----------
    rec : rerun.RecordingStream
    maps : sequence of at most two InitialMap
    """
    import rerun as rr

    for k, color in enumerate(_COLORS):
        entity = f"world/trajectory/hypothesis{k + 1}"
        if k < len(maps):
            path = np.array([keyframe.world_from_cam.t for keyframe in maps[k].keyframes])
            rec.log(entity, rr.LineStrips3D([path], colors=[color], radii=rr.Radius.ui_points(1.5)))
        else:
            rec.log(entity, rr.Clear(recursive=False))
