"""A quad whose texels are mapped by one matrix per line: what the renderers with a rolling shutter share.

Each line of samples (a row, or a column where columns are read) has its own pose, hence its own matrix. It maps what a
sample sees (an ideal pixel, or a ray) to the texel: ``(s, t, 1) / depth``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.render import NEAR_M, blend_levels, detail_nodes
from sequences_synth.textured_quad import Quad

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Ids = NDArray[np.int16]
Bools = NDArray[np.bool_]

# As in :mod:`sequences_synth.render`: a quad whose plane is nearer than this to the camera is seen edge-on.
_EDGE_ON_M = 1e-6


@dataclass(frozen=True, eq=False)
class LineQuad(ABC):
    """A quad in view, with one matrix per line of samples."""

    quad: Quad
    #: Whether columns are exposed one after the other, and not rows.
    by_columns: bool
    #: The matrix of each line of samples.
    texel_from_sight: Floats
    #: rows, columns: Samples that may see the quad.
    rows: slice
    columns: slice

    @abstractmethod
    def points(self, x: Floats, y: Floats) -> Floats:
        """Compute the texels of pixels.

        Shapes: returns (..., 3).
        """

    def points_of_window(self, left: int, top: int, width: int, height: int) -> Floats:
        """Compute the texels of all pixels of a window.

        Shapes: returns (height, width, 3).
        """
        x, y = np.meshgrid(np.arange(left, left + width, dtype=float), np.arange(top, top + height, dtype=float))
        return self.points(x, y)

    def matrices(self, x: Floats, y: Floats) -> Floats:
        """The matrices at pixels: those of their lines.

        Shapes: returns (..., 3, 3).
        """
        pairs = 0.5 * (self.texel_from_sight[0::2] + self.texel_from_sight[1::2])
        line = np.clip(np.round(x if self.by_columns else y).astype(int), 0, len(pairs) - 1)
        return np.asarray(pairs[line])

    def inverse_depth_at(self, x: Floats, y: Floats) -> Floats:
        """Compute the inverse depth of the plane of the quad; see :class:`sequences_synth.render.SeenQuad`.

        Shapes: ``x, y`` (N,), returns (N,).
        """
        return np.asarray(self.points(x, y)[..., 2])

    def window(self, width: int, height: int) -> tuple[slice, slice]:
        """Find the part of the image that may show the quad; see :class:`sequences_synth.render.SeenQuad`."""
        rows, columns = (
            slice(s.start // 2, min((s.stop + 1) // 2, n)) for s, n in ((self.rows, height), (self.columns, width))
        )
        return rows, columns

    def sample(self, left: int, top: int, mask: Image) -> Image:
        """Sample the texture of the quad in a window; see :class:`sequences_synth.render.SeenQuad`.

        Shapes: ``mask`` (H, W), returns (H, W, 3).
        """
        height, width = mask.shape
        texels = _texels(self.points_of_window(left, top, width, height))
        return blend_levels(self.quad, self._detail(left, top, width, height), mask, partial(self._warp, *texels))

    def _warp(self, s: Floats, t: Floats, level: int) -> Image:
        import cv2

        # Far outside of the texture, where pixels are not used, the coordinates may overflow.
        map_s, map_t = (np.clip(0.5**level * c, -1e4, 1e4).astype(np.float32) for c in (s, t))
        texels = self.quad.texture.levels[level]
        return cast(Image, cv2.remap(texels, map_s, map_t, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _detail(self, left: int, top: int, width: int, height: int) -> Floats32:
        """Level of detail, as in :mod:`sequences_synth.render`, by differences over one pixel."""
        x, y = detail_nodes(left, top, width, height)
        here, right, below = (np.stack(_texels(self.points(x + a, y + b))) for a, b in ((0, 0), (1, 0), (0, 1)))
        (sx, tx), (sy, ty) = right - here, below - here
        area, longest = np.abs(sx * ty - sy * tx), np.sqrt(np.maximum(sx * sx + tx * tx, sy * sy + ty * ty))
        with np.errstate(divide="ignore"):
            detail = 0.25 * np.log2(area) + 0.5 * np.log2(longest)
        return np.asarray(np.clip(detail, -10, 30), np.float32)


def _texels(points: Floats) -> tuple[Floats, Floats]:
    w = np.where(np.abs(points[..., 2]) < 1e-12, 1e-12, points[..., 2])  # the horizon itself
    return points[..., 0] / w, points[..., 1] / w


def cam_from_texel_of_lines(quad: Quad, frames: Floats, cam_from_world: Floats) -> tuple[Floats, Bools]:
    """Place a quad before the camera of each line.

    Shapes: ``frames`` (L,), ``cam_from_world`` (L, 4, 4), returns ``cam_from_texel`` (L, 3, 3), returns ``facing``
    (L,).

    * Returns ``facing``: Lines in which the visible side of the quad faces the camera. Elsewhere the matrix may have no
      inverse.
    """
    R, t = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    if quad.moves:
        cam_from_texel = R @ np.stack([quad.world_from_texel(float(frame)) for frame in frames])
    else:
        cam_from_texel = R @ quad.world_from_texel(0.0)
    cam_from_texel[:, :, 2] += t
    distance = np.linalg.det(cam_from_texel) / quad.texel_area
    facing = (distance if quad.one_sided else np.abs(distance)) > _EDGE_ON_M
    return cam_from_texel, facing


def enter(
    seen: LineQuad,
    facing: Bools,
    identity: int,
    value: Callable[[Floats, int], Floats32],
    depth_samples: Floats32,
    id_samples: Ids,
) -> None:
    """Enter one quad into the depth buffer.

    * ``value``: The matrices of the lines, broadcast along the samples of a line, and a row of them -> that row of the
      texels of all samples in the window of the quad.
    """
    part = seen.rows, seen.columns
    lines = part[1] if seen.by_columns else part[0]
    G = np.expand_dims(seen.texel_from_sight[lines], 0 if seen.by_columns else 1)
    drawn = np.expand_dims(facing[lines], 0 if seen.by_columns else 1)
    inverse_depth = value(G, 2)
    window = depth_samples[part]
    wins = (inverse_depth > window) & (inverse_depth < 1 / NEAR_M) & drawn
    for row, size in ((0, seen.quad.texture.width - 1), (1, seen.quad.texture.height - 1)):
        scaled = value(G, row)
        wins &= (scaled >= 0) & (scaled <= np.float32(size) * inverse_depth)
    np.copyto(window, inverse_depth, where=wins)
    np.copyto(id_samples[part], np.int16(identity), where=wins)
