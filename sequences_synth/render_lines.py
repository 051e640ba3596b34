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

import numpy as np
from numpy.typing import NDArray

from sequences_synth.camera import PinholeCamera
from sequences_synth.line_quad import LineQuad, cam_from_texel_of_lines, enter
from sequences_synth.render import NOTHING, View, clip_near, shade
from sequences_synth.textured_quad import Quad

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ids = NDArray[np.int16]
Bools = NDArray[np.bool_]

# The corners of a quad are projected at this many instants of the readout, to bound the part of the image that it
# fills. Between two instants the image moves by 1 or 2 px. The margin contains the curvature of the motion.
_INSTANTS = 33
_MARGIN_PX = 3.0


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
    def for_camera(camera: PinholeCamera, by_columns: bool) -> _Grid:
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
class _SeenLines(LineQuad):
    """A quad in front of the camera: its homographies, one for each line of samples, applied to ideal pixels."""

    grid: _Grid

    def points(self, x: Floats, y: Floats) -> Floats:
        u, v = _ideal(self.grid.camera, x, y)
        G = self.matrices(x, y)
        return np.asarray(G[..., 0] * u[..., None] + G[..., 1] * v[..., None] + G[..., 2])


def render_lines(
    quads: Sequence[Quad],
    camera: PinholeCamera,
    by_columns: bool,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads with one pose per line.

    * ``by_columns``: Whether columns are exposed one after the other, and not rows.
    * ``frame_of``: Row (or column) of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    """
    grid = _Grid.for_camera(camera, by_columns)
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
    cam_from_texel, ahead = cam_from_texel_of_lines(quad, frames, cam_from_world)
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
    return _SeenLines(quad, grid.by_columns, np.asarray(np.linalg.inv(safe)), rows, columns, grid), ahead


def _fill(seen: _SeenLines, ahead: Bools, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer."""
    u, v = seen.grid.part(seen.rows, seen.columns)

    def value(G: Floats, row: int) -> Floats32:
        # The terms are added in double precision per line and in single precision per sample, unless there is a lens.
        a, b, c = G[..., row, 0], G[..., row, 1], G[..., row, 2]
        if u.shape == v.shape:
            return np.asarray(a * u + b * v + c, np.float32)
        across, along = (b * v + c, a * u) if seen.by_columns else (a * u, b * v + c)
        return np.asarray(along + across, np.float32)

    enter(seen, ahead, identity, value, depth_samples, id_samples)


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
