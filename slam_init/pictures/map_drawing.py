"""Draws a map as it is seen along one of the axes of its world: the landmarks, the cameras and their path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam_init.pictures.canvas import ESTIMATE, FAINT, GROUND, INK, TRUTH
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The views by their names: the axes of the world frame (x right, y down, z forward) that point to the right and
#: upwards in the picture, and the sign of the latter.
ABOVE, SIDE, BEHIND = "from above", "from the side", "from behind the first camera"
_VIEWS = {ABOVE: (0, 2, 1.0), SIDE: (2, 1, -1.0), BEHIND: (0, 1, -1.0)}
#: The share of the landmarks that decides the extent: a few far ones would make the rest small.
_QUANTILES = (0.01, 0.99)
#: Depth of a frustum as a share of the extent of the view.
_FRUSTUM = 0.05
#: Margin around the content as a share of its size.
_MARGIN = 0.06
#: Largest number of frusta; more cover one another.
_MOST_FRUSTA = 12


def widest_view(map_: InitialMap) -> str:
    """Choose the view along the axis in which the landmarks spread least: a plane is never seen edge-on."""
    low, high = np.quantile(map_.points, _QUANTILES, axis=0)
    return max(_VIEWS, key=lambda name: float(np.prod((high - low)[list(_VIEWS[name][:2])])))


def draw_map(axes: Axes, map_: InitialMap, view: str, title: str, truth: Floats | None = None) -> None:
    """Draw the landmarks, the path and cameras along it: ``truth`` (N, 3) is the true path."""
    from matplotlib.collections import LineCollection

    right, up, sign = _VIEWS[view]

    def seen(points: Floats) -> Floats:
        return points[..., (right, up)] * (1.0, sign)

    x, y = seen(map_.points).T
    axes.scatter(x, y, s=8, c=map_.colors / 255.0, linewidths=0, alpha=0.95)
    _draw_path(axes, map_, view, truth)
    # The content in the middle, with equal scales in both directions; matplotlib's own may cut it.
    low, high = (seen(corner) for corner in _extent(map_))
    box, middle, size = axes.get_window_extent(), (low + high) / 2, np.abs(high - low)
    scale = (1 + 2 * _MARGIN) * max(size[0] / box.width, size[1] / box.height, 1e-9)
    axes.set_xlim(middle[0] - scale * box.width / 2, middle[0] + scale * box.width / 2)
    axes.set_ylim(middle[1] - scale * box.height / 2, middle[1] + scale * box.height / 2)

    camera, depth = map_.camera, _FRUSTUM * float(size.max())
    half = np.array([camera.width / camera.fx, camera.height / camera.fy, 2.0]) * depth / 2
    corners = half * [[1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]]
    outline = np.array([[a, b] for k, a in enumerate(corners) for b in (np.zeros(3), corners[k - 1])])
    shown = map_.keyframes[:: max(1, -(-len(map_.keyframes) // _MOST_FRUSTA))]
    lines = [line for keyframe in shown for line in seen(keyframe.world_from_cam.apply(outline))]
    axes.add_collection(LineCollection(lines, colors=ESTIMATE, linewidths=0.9), autolim=False)

    axes.set_facecolor(GROUND)
    axes.set_title(title, loc="left", color=INK, fontsize=9.5, pad=4)
    axes.tick_params(labelsize=8, colors=FAINT, length=0)
    axes.grid(color=FAINT, alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("median depths" if map_.scale is None else "metres", fontsize=8, color=FAINT, labelpad=1)


def draw_cameras(axes: Axes, map_: InitialMap, view: str, truth: Floats | None = None) -> None:
    """Draw the path of the cameras alone, since it is often short beside the depth of the scene."""
    _draw_path(axes, map_, view, truth)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    axes.set_facecolor(GROUND)
    axes.set_title("the cameras alone", loc="left", color="white", fontsize=9, pad=3)
    axes.tick_params(labelsize=7, colors=FAINT, length=0)
    axes.locator_params(nbins=4)
    axes.spines[:].set_color(FAINT)
    axes.legend(loc="best", fontsize=8, labelcolor="white")


def _draw_path(axes: Axes, map_: InitialMap, view: str, truth: Floats | None) -> None:
    right, up, sign = _VIEWS[view]
    path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
    if truth is not None and len(truth) > 1:
        axes.plot(truth[:, right], sign * truth[:, up], "--", color=TRUTH, linewidth=2.2, label="ground truth")
    axes.plot(path[:, right], sign * path[:, up], ".-", color=ESTIMATE, linewidth=1.4, markersize=5, label="estimate")


def _extent(map_: InitialMap) -> tuple[Floats, Floats]:
    """The least and the largest coordinates (3,) of nearly all landmarks and of the cameras."""
    near, far = np.quantile(map_.points, _QUANTILES, axis=0)
    path = [keyframe.world_from_cam.t for keyframe in map_.keyframes]
    return np.min([near, *path], axis=0), np.max([far, *path], axis=0)
