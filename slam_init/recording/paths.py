"""Paths in a recording: the dashed path of the ground truth, and two undecided maps with their paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slam_init.recording.layout import ESTIMATE_COLOR, TWINS, Color
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

#: Number of dashes of the ground truth. It is dashed so that the estimate can be seen where both agree.
_DASHES = 30
#: The better one of two undecided maps, and its rival.
CONJUGATE_NAMES = ("a", "b")
#: Size of a frustum in units of the map, whose median depth is 1.
_FRUSTUM = 0.08
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
#: Colours of the better one of two undecided maps, and of its rival.
_COLORS: tuple[Color, ...] = ((190, 120, 255), (130, 110, 150))


def dashes(positions: Floats) -> list[Floats]:
    """Cut a path into pieces of equal length, and return every other piece: ``positions`` (N, 3), returns (M, 3)."""
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
    """Log the paths of up to two maps, and clear the entities of the maps that do not exist."""
    import rerun as rr

    for k, color in enumerate(_COLORS):
        entity = f"world/trajectory/hypothesis{k + 1}"
        if k < len(maps):
            path = np.array([keyframe.world_from_cam.t for keyframe in maps[k].keyframes])
            thin, label = rr.Radius.ui_points(1.5), f"map {CONJUGATE_NAMES[k].upper()}"
            rec.log(entity, rr.LineStrips3D([path], colors=[color], radii=thin, labels=[label], show_labels=True))
        else:
            rec.log(entity, rr.Clear(recursive=False))


def log_conjugate_maps(rec: Any, maps: Sequence[InitialMap]) -> None:
    """Log the landmarks, the frusta and the path of up to two maps, each in a space of its own; clear the others."""
    import rerun as rr

    for k, name in enumerate(CONJUGATE_NAMES):
        entity = f"{TWINS}/{name}"
        if k >= len(maps):
            rec.log(entity, rr.Clear(recursive=True))
            continue
        map_ = maps[k]
        rec.log(entity, rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        rec.log(f"{entity}/points", rr.Points3D(map_.points, colors=map_.colors, radii=rr.Radius.ui_points(2.5)))
        strips = [strip for keyframe in map_.keyframes for strip in _frustum(map_, keyframe.world_from_cam)]
        thin = rr.Radius.ui_points(1.0)
        rec.log(f"{entity}/keyframes", rr.LineStrips3D(strips, colors=[ESTIMATE_COLOR], radii=thin))
        path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
        rec.log(f"{entity}/path", rr.LineStrips3D([path], colors=[_COLORS[0]], radii=rr.Radius.ui_points(1.5)))


def _frustum(map_: InitialMap, world_from_cam: Pose) -> list[Floats]:
    """The outline of the image and the edges from the centre to its corners, as line strips."""
    camera = map_.camera
    x, y = _FRUSTUM * camera.width / (2 * camera.fx), _FRUSTUM * camera.height / (2 * camera.fy)
    corners = world_from_cam.apply(np.array([[sx * x, sy * y, _FRUSTUM] for sx, sy in _CORNERS]))
    centre = world_from_cam.t
    return [corners[[0, 1, 2, 3, 0]], *(np.stack([centre, corner]) for corner in corners)]
