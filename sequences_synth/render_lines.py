"""Rendering with a rolling shutter or a lens: each line of samples has its own pose.

A line is a row, or a column where columns are read. Its matrix maps what a sample sees to the texel of a quad: ``(s, t,
1) / depth``. There are two rows and two columns of samples per pixel, as in :mod:`sequences_synth.render`, and within
half a row the camera does not move. With a readout of 30 ms and a motion of the image by 1500 px/s this is an error of
0.02 px at most for the silhouettes. For colours the mean of both matrices is used; its error is of second order.

* A pinhole camera: what a sample sees is the place at which an ideal camera would see its ray, which takes care of
  radial distortion. The matrix is the inverse of ``K cam_from_world(t_row) world_from_texel(t_row)``.
* A lens of any field of view: what a sample sees is its ray d, which meets the plane of a quad at
  ``G d = (s, t, 1) / distance`` with ``G = (cam_from_world world_from_texel)^-1``. So the depth buffer holds the
  inverse distance along the ray, which is positive behind the image plane too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np

from sequences_synth.arrays import Bools, Floats, Floats32, Ids, Image
from sequences_synth.camera import LensCamera, PinholeCamera, sample_rays
from sequences_synth.render import NEAR_M, NOTHING, View, blend_levels, clip_near, detail_nodes, shade
from sequences_synth.textured_quad import Quad

# -- a quad in view --------------------------------------------------------------------------------


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

    @abstractmethod
    def row_of_texels(self, G: Floats, row: int) -> Floats32:
        """Compute one row of the texels of all samples in the window of the quad.

        * ``G``: The matrices of the lines, broadcast along the samples of a line.
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


def _cam_from_texel(quad: Quad, frames: Floats, cam_from_world: Floats) -> tuple[Floats, Bools]:
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


def _enter(seen: LineQuad, facing: Bools, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer."""
    part = seen.rows, seen.columns
    lines = part[1] if seen.by_columns else part[0]
    G = np.expand_dims(seen.texel_from_sight[lines], 0 if seen.by_columns else 1)
    drawn = np.expand_dims(facing[lines], 0 if seen.by_columns else 1)
    inverse_depth = seen.row_of_texels(G, 2)
    window = depth_samples[part]
    wins = (inverse_depth > window) & (inverse_depth < 1 / NEAR_M) & drawn
    for row, size in ((0, seen.quad.texture.width - 1), (1, seen.quad.texture.height - 1)):
        scaled = seen.row_of_texels(G, row)
        wins &= (scaled >= 0) & (scaled <= np.float32(size) * inverse_depth)
    np.copyto(window, inverse_depth, where=wins)
    np.copyto(id_samples[part], np.int16(identity), where=wins)


def render_lines(
    quads: Sequence[Quad],
    camera: PinholeCamera | LensCamera,
    by_columns: bool,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads with one pose per line.

    * ``by_columns``: Whether columns are exposed one after the other, and not rows.
    * ``frame_of``: Row (or column) of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    * Returns: Of a lens camera, its inverse depth is the inverse distance along the ray of a pixel.
    """
    frames = frame_of(_samples(camera.width if by_columns else camera.height))
    different, which = np.unique(frames, return_inverse=True)
    poses: Floats = np.stack([world_from_cam(float(frame)) for frame in different])
    cam_from_world = np.asarray(np.linalg.inv(poses)[which], np.float64)
    depth_samples = np.zeros((2 * camera.height, 2 * camera.width), np.float32)
    id_samples = np.full(depth_samples.shape, NOTHING, np.int16)
    see: Callable[[Quad, Floats, Bools], LineQuad | None] = (
        partial(_see_rays, camera, by_columns)
        if isinstance(camera, LensCamera)
        else partial(_see_lines, _Grid.for_camera(camera, by_columns))
    )
    seen = {}
    for i, quad in enumerate(quads):
        cam_from_texel, facing = _cam_from_texel(quad, frames, cam_from_world)
        found = see(quad, cam_from_texel, facing) if facing.any() else None
        if found is not None:
            seen[i] = found
            _enter(found, facing, i, depth_samples, id_samples)
    return shade(len(quads), seen, depth_samples, id_samples)


# -- pinhole ---------------------------------------------------------------------------------------


# The corners of a quad are projected at this many instants of the readout, to bound the part of the image that it
# fills. Between two instants the image moves by 1 or 2 px. The margin contains the curvature of the motion.
_OUTLINES = 33
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

    def row_of_texels(self, G: Floats, row: int) -> Floats32:
        u, v = self.grid.part(self.rows, self.columns)
        # The terms are added in double precision per line and in single precision per sample, unless there is a lens.
        a, b, c = G[..., row, 0], G[..., row, 1], G[..., row, 2]
        if u.shape == v.shape:
            return np.asarray(a * u + b * v + c, np.float32)
        across, along = (b * v + c, a * u) if self.by_columns else (a * u, b * v + c)
        return np.asarray(along + across, np.float32)


def _see_lines(grid: _Grid, quad: Quad, cam_from_texel: Floats, facing: Bools) -> _SeenLines | None:
    """Project a quad, of which some lines see the visible side; None if it is not in view."""
    w, h = quad.texture.width - 1, quad.texture.height - 1
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float)
    K, outline = grid.camera.K, []
    for k in np.linspace(0, len(facing) - 1, _OUTLINES).round().astype(int):
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
    safe = np.where(facing[:, None, None], K @ cam_from_texel, np.eye(3))
    return _SeenLines(quad, grid.by_columns, np.asarray(np.linalg.inv(safe)), rows, columns, grid)


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


# -- lenses ----------------------------------------------------------------------------------------


# The window of a quad is found by the rays of every sixteenth sample, and by as many points of the quad as this on each
# side; it is widened by as many samples. A part of a quad that both miss is smaller than the margin.
_NODE_STEP, _POINTS = 16, 9
# The window holds the quad at the first, the middle and the last line of the readout.
_INSTANTS = (0, 0.5, 1)


@dataclass(frozen=True, eq=False)
class _SeenRays(LineQuad):
    """A quad within the field of view: its matrices, one for each line of samples, applied to rays."""

    camera: LensCamera

    def points(self, x: Floats, y: Floats) -> Floats:
        return self._met(x, y, self.camera.rays(np.stack([x, y], axis=-1)))

    def points_of_window(self, left: int, top: int, width: int, height: int) -> Floats:
        x, y = np.meshgrid(np.arange(left, left + width, dtype=float), np.arange(top, top + height, dtype=float))
        return self._met(x, y, sample_rays(self.camera, 1)[top : top + height, left : left + width])

    def inverse_depth_at(self, x: Floats, y: Floats) -> Floats:
        x, y = np.floor(x), np.floor(y)
        return np.asarray(self._met(x, y, sample_rays(self.camera, 1)[y.astype(int), x.astype(int)])[..., 2])

    def _met(self, x: Floats, y: Floats, rays: Floats) -> Floats:
        """Where rays of pixels meet the quad: ``(s, t, 1) / distance``."""
        return np.asarray(np.einsum("...ij,...j->...i", self.matrices(x, y), rays))

    def row_of_texels(self, G: Floats, row: int) -> Floats32:
        rays = sample_rays(self.camera, 2)[self.rows, self.columns]
        first, second, third = (G[..., row, q] * rays[..., q] for q in range(3))
        return np.asarray(first + second + third, np.float32)


def _see_rays(
    camera: LensCamera, by_columns: bool, quad: Quad, cam_from_texel: Floats, facing: Bools
) -> _SeenRays | None:
    """Find the window of a quad, of which some lines see the visible side; None if it is not in view."""
    # A line in which the quad is edge-on has no inverse; it is not drawn there.
    texel_from_ray = np.asarray(np.linalg.inv(np.where(facing[:, None, None], cam_from_texel, np.eye(3))))
    size = np.array([quad.texture.width - 1, quad.texture.height - 1], float)
    boxes = [
        _box(camera, size, cam_from_texel[k], texel_from_ray[k])
        for k in (round(instant * (len(facing) - 1)) for instant in _INSTANTS)
        if facing[k]
    ]
    found = np.concatenate([box for box in boxes if len(box)] or [np.zeros((0, 2))])
    if not len(found):
        return None
    low, high = found.min(axis=0) - _NODE_STEP, found.max(axis=0) + _NODE_STEP + 1
    columns, rows = (
        slice(max(0, int(a)), min(2 * side, int(b)))
        for a, b, side in zip(low, high, (camera.width, camera.height), strict=True)
    )
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    return _SeenRays(quad, by_columns, texel_from_ray, rows, columns, camera)


def _box(camera: LensCamera, size: Floats, cam_from_texel: Floats, texel_from_ray: Floats) -> Floats:
    """Samples (N, 2), as column and row, that see a quad: of a coarse grid, and those of points of the quad."""
    nodes = sample_rays(camera, 2)[::_NODE_STEP, ::_NODE_STEP]
    p = nodes @ texel_from_ray.T
    inside = (p[..., 2] > 0) & (p[..., :2] >= 0).all(axis=-1) & (p[..., :2] <= size * p[..., 2:]).all(axis=-1)
    rows, columns = np.nonzero(inside)
    s, t = np.meshgrid(*(np.linspace(0, side, _POINTS) for side in size))
    points = np.column_stack([s.ravel(), t.ravel(), np.ones(s.size)]) @ cam_from_texel.T
    angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    pixels = camera.project(points[angle <= camera.half_field_rad])
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    return np.concatenate([_NODE_STEP * np.column_stack([columns, rows]).astype(float), 2 * pixels + 0.5])
