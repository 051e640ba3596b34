"""Parts of a picture: a map from above and from the side, with its cameras and a scale bar."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from slam_init.pictures.style import ESTIMATE, INK, TRUTH
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The axes of the world frame (x right, y down, z forward) that point to the right and upwards in the picture, and the
#: sign of the latter.
ABOVE, SIDE = "above", "side"
_AXES = {ABOVE: (0, 2, 1.0), SIDE: (2, 1, -1.0)}
_GROUND = "#11161d"
#: The share of the landmarks that decides the extent: a few far ones would make the rest small.
_QUANTILES = (0.01, 0.99)
#: Size of a frustum as a share of the extent of the view.
_FRUSTUM, _FRUSTUM_OF_PATH = 0.07, 0.16
#: Margin around the content as a share of its size, and room for the scale bar as a share of the height of the view.
_MARGIN, _BAR_ROOM = 0.06, 0.14
#: Largest number of frusta; more cover one another.
_MOST_FRUSTA = 12


def draw_map(axes: Axes, map_: InitialMap, view: str, title: str, truth: Floats | None = None) -> None:
    """Draw the landmarks, the path, and the first and the last camera: ``truth`` (N, 3)."""
    right, up, sign = _AXES[view]
    points = map_.points
    axes.scatter(
        points[:, right], sign * points[:, up], s=5, c=map_.colors / 255.0, linewidths=0, alpha=0.95, rasterized=True
    )
    path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
    low, high = np.quantile(points, _QUANTILES, axis=0)
    low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    _frame(axes, low, high, view, title)
    size = _FRUSTUM * float(max(high[right] - low[right], high[up] - low[up]))
    poses = [map_.keyframes[0].world_from_cam, map_.keyframes[-1].world_from_cam]
    _draw_path(axes, map_, poses, path, size, view, truth)
    _draw_scale_bar(axes, map_)


def draw_cameras(axes: Axes, map_: InitialMap, view: str, truth: Floats | None = None) -> None:
    """Draw the cameras alone, as large as they fit: a path is often short beside the depth of the scene.

    Shapes: ``truth`` (N, 3).
    """
    path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
    extent = float(np.linalg.norm(path.max(axis=0) - path.min(axis=0))) or 1e-3
    size = _FRUSTUM_OF_PATH * extent
    low, high = path.min(axis=0) - 1.2 * size, path.max(axis=0) + 1.2 * size
    _frame(axes, low, high, view, f"the {len(path)} cameras, from {_named(view)}")
    step = max(1, -(-len(path) // _MOST_FRUSTA))
    poses = [keyframe.world_from_cam for keyframe in map_.keyframes[::step]]
    _draw_path(axes, map_, poses, path, size, view, truth)
    _draw_scale_bar(axes, map_)


def _named(view: str) -> str:
    return "above" if view == ABOVE else "the side"


def _frame(axes: Axes, low: Floats, high: Floats, view: str, title: str) -> None:
    """Set the extent of a dark view with equal scales in both directions: the content, over room for the scale bar."""
    right, up, sign = _AXES[view]
    left, width = low[right], max(high[right] - low[right], 1e-9)
    below, above = sorted((sign * low[up], sign * high[up]))
    height = max(above - below, 1e-9)
    # Matplotlib's own equal scales may cut the content.
    box = axes.get_window_extent()
    scale = (1 + 2 * _MARGIN) * max(width / box.width, height / (box.height * (1 - _BAR_ROOM)))
    middle_x, middle_y = left + width / 2, (below + above - _BAR_ROOM * scale * box.height) / 2
    axes.set_xlim(middle_x - scale * box.width / 2, middle_x + scale * box.width / 2)
    axes.set_ylim(middle_y - scale * box.height / 2, middle_y + scale * box.height / 2)
    axes.set_facecolor(_GROUND)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, loc="left", color=INK, fontsize=9.5, pad=4)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_path(
    axes: Axes, map_: InitialMap, poses: list[Pose], path: Floats, size: float, view: str, truth: Floats | None
) -> None:
    from matplotlib.collections import PolyCollection

    right, up, sign = _AXES[view]
    if truth is not None and len(truth) > 1:
        axes.plot(
            truth[:, right], sign * truth[:, up], "--", color=TRUTH, linewidth=2.2, label="ground truth", zorder=3
        )
    axes.plot(path[:, right], sign * path[:, up], "-", color=ESTIMATE, linewidth=1.4, label="cameras", zorder=4)
    camera, K = map_.camera, map_.camera.K
    corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)])
    corners *= (size * camera.width / (2 * K[0, 0]), size * camera.height / (2 * K[1, 1]), size)
    # The outline of a frustum, seen along an axis: the apex, and the middles of the sides to the left and right, or
    # above and below.
    sides = (corners[:2], corners[2:]) if view == ABOVE else (corners[::2], corners[1::2])
    outlines = []
    for pose in poses:
        outline = pose.apply(np.array([np.zeros(3), *(side.mean(axis=0) for side in sides)]))
        outlines.append(np.column_stack([outline[:, right], sign * outline[:, up]]))
    axes.add_collection(
        PolyCollection(outlines, facecolors="none", edgecolors=ESTIMATE, linewidths=1.2, zorder=5), autolim=False
    )


def _draw_scale_bar(axes: Axes, map_: InitialMap) -> None:
    """A bar of a round length, a fifth to a half of the width of the view."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    width = right - left
    decade = 10.0 ** math.floor(math.log10(0.4 * width))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.4 * width)
    x, y = left + 0.05 * width, low + 0.07 * (high - low)
    axes.plot([x, x + length], [y, y], "-", color="white", linewidth=2.5, solid_capstyle="butt", zorder=6)
    label = f"{length:g} of the median depth" if map_.scale is None else f"{length:g} m"
    axes.text(x, y + 0.02 * (high - low), label, color="white", fontsize=8, va="bottom", zorder=6)
