"""Rendering with a rolling shutter and a lens: each row has its own pose, and each pixel its own ray.

The texels of a quad map to the pixels of one row by a homography, as in :mod:`sequences_synth.render`. Here each row of
samples (or column, where columns are read) has its own homography ``K cam_from_world(t_row) world_from_texel(t_row)``.
It is applied to the place at which an ideal camera would see the ray of the pixel, which takes care of radial
distortion. The image is therefore exact, up to the texture's resampling: there are two rows of samples per row of
pixels, and within half a row the camera does not move. With a readout of 30 ms and a motion of the image by 1500 px/s
this is an error of 0.02 px at most for the silhouettes. For colours the mean of both homographies is used; its error is
of second order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.camera import PinholeCamera
from sequences_synth.render import NEAR_M, NOTHING, View, blend_levels, clip_near, detail_nodes, shade
from sequences_synth.textured_quad import Quad

__all__ = ["render_lines"]

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Ids = NDArray[np.int16]
Bools = NDArray[np.bool_]

# The corners of a quad are projected at this many instants of the readout, to bound the part of the image that it
# fills. Between two instants the image moves by 1 or 2 px. The margin contains the curvature of the motion.
_INSTANTS = 33
_MARGIN_PX = 3.0
# As in :mod:`sequences_synth.render`: a quad whose plane is nearer than this to the camera is seen edge-on.
_EDGE_ON_M = 1e-6


@dataclass(frozen=True, eq=False)
class _Grid:
    """The places at which an ideal camera would see the rays of the samples.

    Sample (i, j) lies at pixel (j / 2 - 1/4, i / 2 - 1/4). Without distortion ``u`` is (1, 2 W) and ``v`` is (2 H, 1).
    """

    camera: PinholeCamera
    by_columns: bool
    u: Floats
    v: Floats

    @staticmethod
    def of(camera: PinholeCamera, by_columns: bool) -> _Grid:
        x, y = _samples(camera.width), _samples(camera.height)
        if camera.k1 == 0.0:
            return _Grid(camera, by_columns, x[None, :], y[:, None])
        u, v = _ideal(camera, *np.meshgrid(x, y))
        return _Grid(camera, by_columns, u, v)

    def part(self, rows: slice, columns: slice) -> tuple[Floats, Floats]:
        u = self.u[rows if len(self.u) > 1 else slice(None), columns]
        v = self.v[rows, columns if self.v.shape[1] > 1 else slice(None)]
        return u, v

    def within(self, low: Floats, high: Floats) -> tuple[slice, slice]:
        """Rows and columns of samples that may see the ideal pixels from ``low`` to ``high``; may be empty."""
        columns = _range((self.u.max(axis=0) >= low[0]) & (self.u.min(axis=0) <= high[0]))
        rows = _range((self.v.max(axis=1) >= low[1]) & (self.v.min(axis=1) <= high[1]))
        return rows, columns


@dataclass(frozen=True, eq=False)
class _SeenLines:
    """A quad in front of the camera: its homographies, one for each line of samples."""

    quad: Quad
    grid: _Grid
    texel_from_ideal: Floats  # (2 L, 3, 3), applied to (u, v, 1): (s, t, 1) / z
    rows: slice  # of samples
    columns: slice

    def inverse_depth_at(self, x: Floats, y: Floats) -> Floats:
        u, v = _ideal(self.grid.camera, x, y)
        return np.asarray(self._apply(self._pixel_lines(x, y), u, v)[..., 2])

    def window(self, width: int, height: int) -> tuple[slice, slice]:
        rows, columns = (slice(s.start // 2, min((s.stop + 1) // 2, n)) for s, n in
                         ((self.rows, height), (self.columns, width)))  # fmt: skip
        return rows, columns

    def sample(self, left: int, top: int, mask: Image) -> Image:
        import cv2

        height, width = mask.shape
        x, y = np.meshgrid(np.arange(left, left + width, dtype=float), np.arange(top, top + height, dtype=float))
        s, t = self._texels(x, y)

        def warp(level: int) -> Image:
            # Far outside of the texture, where pixels are not used, the coordinates may overflow.
            map_s, map_t = (np.clip(0.5**level * c, -1e4, 1e4).astype(np.float32) for c in (s, t))
            texels = self.quad.texture.levels[level]
            return cast(Image, cv2.remap(texels, map_s, map_t, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

        return blend_levels(self.quad, self._detail(left, top, width, height), mask, warp)

    def _detail(self, left: int, top: int, width: int, height: int) -> Floats32:
        """Level of detail, as in :mod:`sequences_synth.render`, by differences over one pixel."""
        x, y = detail_nodes(left, top, width, height)
        here, right, below = (np.stack(self._texels(x + a, y + b)) for a, b in ((0, 0), (1, 0), (0, 1)))
        (sx, tx), (sy, ty) = right - here, below - here
        area, longest = np.abs(sx * ty - sy * tx), np.sqrt(np.maximum(sx * sx + tx * tx, sy * sy + ty * ty))
        with np.errstate(divide="ignore"):
            detail = 0.25 * np.log2(area) + 0.5 * np.log2(longest)
        return np.asarray(np.clip(detail, -10, 30), np.float32)

    def _texels(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Texels of pixels."""
        u, v = _ideal(self.grid.camera, x, y)
        p = self._apply(self._pixel_lines(x, y), u, v)
        w = np.where(np.abs(p[..., 2]) < 1e-12, 1e-12, p[..., 2])  # the horizon itself
        return p[..., 0] / w, p[..., 1] / w

    def _pixel_lines(self, x: Floats, y: Floats) -> Floats:
        """Homographies (..., 3, 3) at pixels: those of their lines."""
        pairs = 0.5 * (self.texel_from_ideal[0::2] + self.texel_from_ideal[1::2])
        line = np.clip(np.round(x if self.grid.by_columns else y).astype(int), 0, len(pairs) - 1)
        return np.asarray(pairs[line])

    @staticmethod
    def _apply(G: Floats, u: Floats, v: Floats) -> Floats:
        return np.asarray(G[..., 0] * u[..., None] + G[..., 1] * v[..., None] + G[..., 2])


def render_lines(
    quads: Sequence[Quad],
    camera: PinholeCamera,
    by_columns: bool,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads with one pose per line.

    Parameters
    ----------
    quads : sequence of Quad
    camera : PinholeCamera
        True camera, with its distortion.
    by_columns : bool
        Whether columns are exposed one after the other, and not rows.
    frame_of : callable
        Row (or column) of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    world_from_cam : callable
        Frame number -> pose (4, 4), metres.

    Returns
    -------
    View
    """
    grid = _Grid.of(camera, by_columns)
    lines = _samples(camera.width if by_columns else camera.height)
    frames = frame_of(lines)
    cam_from_world = np.linalg.inv(np.stack([world_from_cam(float(frame)) for frame in frames]))
    depth_samples = np.zeros((2 * camera.height, 2 * camera.width), np.float32)
    id_samples = np.full(depth_samples.shape, NOTHING, np.int16)
    seen = {}
    for i, quad in enumerate(quads):
        found = _see(quad, grid, frames, cam_from_world)
        if found is not None:
            seen[i], ahead = found
            _fill(seen[i], ahead, i, depth_samples, id_samples)
    return shade(len(quads), seen, depth_samples, id_samples)


def _see(quad: Quad, grid: _Grid, frames: Floats, cam_from_world: Floats) -> tuple[_SeenLines, Bools] | None:
    """Project a quad; and the lines (2 L,) in which its visible side faces the camera. None if it is not visible."""
    R, t = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    if quad.moves:
        cam_from_texel = R @ np.stack([quad.world_from_texel(float(frame)) for frame in frames])
    else:
        cam_from_texel = R @ quad.world_from_texel(0.0)
    cam_from_texel[:, :, 2] += t
    distance = np.linalg.det(cam_from_texel) / quad.texel_area
    ahead = (distance if quad.one_sided else np.abs(distance)) > _EDGE_ON_M
    if not ahead.any():
        return None
    w, h = quad.texture.width - 1, quad.texture.height - 1
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float)
    K, outline = grid.camera.K, []
    for k in np.linspace(0, len(frames) - 1, _INSTANTS).round().astype(int):
        polygon = clip_near(corners @ cam_from_texel[k].T)
        if len(polygon):
            projected = polygon @ K.T
            outline.append(projected[:, :2] / projected[:, 2:])
    if not outline:
        return None
    low, high = np.concatenate(outline).min(axis=0) - _MARGIN_PX, np.concatenate(outline).max(axis=0) + _MARGIN_PX
    rows, columns = grid.within(low, high)
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    # A line in which the quad is edge-on has no homography; it is not drawn there.
    safe = np.where(ahead[:, None, None], K @ cam_from_texel, np.eye(3))
    return _SeenLines(quad, grid, np.asarray(np.linalg.inv(safe)), rows, columns), ahead


def _fill(seen: _SeenLines, ahead: Bools, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer."""
    part = seen.rows, seen.columns
    by_columns = seen.grid.by_columns
    u, v = seen.grid.part(*part)
    lines = part[1] if by_columns else part[0]
    # Homographies and lines are broadcast along the pixels of a line.
    G = np.expand_dims(seen.texel_from_ideal[lines], 0 if by_columns else 1)
    facing = np.expand_dims(ahead[lines], 0 if by_columns else 1)

    def value(row: int) -> Floats32:
        # The terms are added in double precision per line and in single precision per sample, unless there is a lens.
        a, b, c = G[..., row, 0], G[..., row, 1], G[..., row, 2]
        if u.shape == v.shape:
            return np.asarray(a * u + b * v + c, np.float32)
        across, along = (b * v + c, a * u) if by_columns else (a * u, b * v + c)
        return np.asarray(along + across, np.float32)

    inverse_depth = value(2)
    window = depth_samples[part]
    wins = (inverse_depth > window) & (inverse_depth < 1 / NEAR_M) & facing
    for row, size in ((0, seen.quad.texture.width - 1), (1, seen.quad.texture.height - 1)):
        scaled = value(row)
        wins &= (scaled >= 0) & (scaled <= np.float32(size) * inverse_depth)
    np.copyto(window, inverse_depth, where=wins)
    np.copyto(id_samples[part], np.int16(identity), where=wins)


def _samples(pixels: int) -> Floats:
    """Rows or columns of samples, in pixels."""
    return np.asarray(0.5 * np.arange(2 * pixels) - 0.25, float)


def _ideal(camera: PinholeCamera, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Where a camera without distortion would see the rays of the pixels."""
    if camera.k1 == 0.0:
        return np.asarray(x, float), np.asarray(y, float)
    rays = camera.rays(np.stack([x, y], axis=-1))
    return camera.fx * rays[..., 0] + camera.cx, camera.fy * rays[..., 1] + camera.cy


def _range(mask: Bools) -> slice:
    """The indices from the first to the last that is set."""
    chosen = np.flatnonzero(mask)
    return slice(int(chosen[0]), int(chosen[-1]) + 1) if len(chosen) else slice(0, 0)
