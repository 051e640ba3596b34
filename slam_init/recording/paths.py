"""Trajectories in a recording: the dashed path of the ground truth, and the paths of two undecided maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slam_init.recording.layout import Color
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap

__all__ = ["dashes", "log_hypotheses"]

#: Number of dashes of the ground truth. It is dashed so that the estimate can be seen where both agree.
_DASHES = 30
#: Colours of the better one of two undecided maps, and of its rival.
_COLORS: tuple[Color, ...] = ((190, 120, 255), (130, 110, 150))


def dashes(positions: Floats) -> list[Floats]:
    """Cut a path into pieces of equal length, and return every other piece.

    Parameters
    ----------
    positions : (N, 3) float
        The path.

    Returns
    -------
    list of (M, 3) float
    """
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    cuts = np.linspace(0, along[-1], 2 * _DASHES)
    pieces = []
    for begin, end in cuts.reshape(-1, 2):
        # The corners of the path within a dash are kept.
        at = np.concatenate([[begin], along[(along > begin) & (along < end)], [end]])
        pieces.append(np.stack([np.interp(at, along, column) for column in positions.T], axis=1))
    return pieces


def log_hypotheses(rec: Any, maps: Sequence[InitialMap]) -> None:
    """Log the paths of up to two maps, and clear the entities of the maps that do not exist.

    Parameters
    ----------
    rec : rerun.RecordingStream
    maps : sequence of InitialMap
        At most two, the better one first.
    """
    import rerun as rr

    for k, color in enumerate(_COLORS):
        entity = f"world/trajectory/hypothesis{k + 1}"
        if k < len(maps):
            path = np.array([keyframe.world_from_cam.t for keyframe in maps[k].keyframes])
            rec.log(entity, rr.LineStrips3D([path], colors=[color], radii=rr.Radius.ui_points(1.5)))
        else:
            rec.log(entity, rr.Clear(recursive=False))
