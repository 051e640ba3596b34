"""Rendering through a lens of any field of view: each sample has its own ray, and each row its own pose.

A ray d meets the plane of a quad at ``G d = (s, t, 1) / distance`` with ``G = (cam_from_world world_from_texel)^-1``
and the texel (s, t). So the depth buffer holds the inverse distance along the ray, which is positive behind the image
plane too. There are two rows and two columns of samples per pixel, as in :mod:`sequences_synth.render`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.lens_camera import LensCamera, sample_rays
from sequences_synth.render import NEAR_M, NOTHING, View, blend_levels, detail_nodes, shade
from sequences_synth.textured_quad import Quad

__all__ = ["render_rays"]

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Ids = NDArray[np.int16]
Bools = NDArray[np.bool_]

# The window of a quad is found by the rays of every sixteenth sample, and by as many points of the quad as this on each
# side; it is widened by as many samples. A part of a quad that both miss is smaller than the margin.
_NODE_STEP, _POINTS = 16, 9
# The window holds the quad at the first, the middle and the last line of the readout.
_INSTANTS = (0, 0.5, 1)
# As in :mod:`sequences_synth.render`: a quad whose plane is nearer than this to the camera is seen edge-on.
_EDGE_ON_M = 1e-6


@dataclass(frozen=True, eq=False)
class _SeenRays:
    """A quad within the field of view."""

    quad: Quad
    camera: LensCamera
    by_columns: bool
    texel_from_ray: Floats  # (2 L, 3, 3) for each line of samples
    rows: slice  # of samples
    columns: slice

    def inverse_depth_at(self, x: Floats, y: Floats) -> Floats:
        column, row = np.asarray(x).astype(int), np.asarray(y).astype(int)
        rays = sample_rays(self.camera, 1)[row, column]
        return np.asarray(self._apply(self._pixel_lines(column, row), rays)[..., 2])

    def window(self, width: int, height: int) -> tuple[slice, slice]:
        rows, columns = (
            slice(s.start // 2, min((s.stop + 1) // 2, n)) for s, n in ((self.rows, height), (self.columns, width))
        )
        return rows, columns

    def sample(self, left: int, top: int, mask: Image) -> Image:
        import cv2

        height, width = mask.shape
        x, y = np.meshgrid(np.arange(left, left + width), np.arange(top, top + height))
        s, t = self._texels(x, y, sample_rays(self.camera, 1)[top : top + height, left : left + width])

        def warp(level: int) -> Image:
            # Far outside of the texture, where pixels are not used, the coordinates may overflow.
            map_s, map_t = (np.clip(0.5**level * c, -1e4, 1e4).astype(np.float32) for c in (s, t))
            texels = self.quad.texture.levels[level]
            return cast(Image, cv2.remap(texels, map_s, map_t, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

        return blend_levels(self.quad, self._detail(left, top, width, height), mask, warp)

    def _detail(self, left: int, top: int, width: int, height: int) -> Floats32:
        """Level of detail, as in :mod:`sequences_synth.render`, by differences over one pixel."""
        x, y = detail_nodes(left, top, width, height)
        here, right, below = (
            np.stack(self._texels(x, y, self.camera.rays(np.stack([x + a, y + b], axis=-1))))
            for a, b in ((0, 0), (1, 0), (0, 1))
        )
        (sx, tx), (sy, ty) = right - here, below - here
        area, longest = np.abs(sx * ty - sy * tx), np.sqrt(np.maximum(sx * sx + tx * tx, sy * sy + ty * ty))
        with np.errstate(divide="ignore"):
            detail = 0.25 * np.log2(area) + 0.5 * np.log2(longest)
        return np.asarray(np.clip(detail, -10, 30), np.float32)

    def _texels(self, x: Floats, y: Floats, rays: Floats) -> tuple[Floats, Floats]:
        p = self._apply(self._pixel_lines(x, y), rays)
        w = np.where(np.abs(p[..., 2]) < 1e-12, 1e-12, p[..., 2])  # the horizon itself
        return p[..., 0] / w, p[..., 1] / w

    def _pixel_lines(self, x: Floats, y: Floats) -> Floats:
        """Matrices (..., 3, 3) at pixels: those of their lines."""
        pairs = 0.5 * (self.texel_from_ray[0::2] + self.texel_from_ray[1::2])
        line = np.clip(np.round(x if self.by_columns else y).astype(int), 0, len(pairs) - 1)
        return np.asarray(pairs[line])

    @staticmethod
    def _apply(G: Floats, rays: Floats) -> Floats:
        return np.asarray(np.einsum("...ij,...j->...i", G, rays))


def render_rays(
    quads: Sequence[Quad],
    camera: LensCamera,
    by_columns: bool,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads through a lens, with one pose per line.

    Parameters
    ----------
    quads : sequence of Quad
    camera : LensCamera
    by_columns : bool
        Whether columns are exposed one after the other, and not rows.
    frame_of : callable
        Row (or column) of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    world_from_cam : callable
        Frame number -> pose (4, 4), metres.

    Returns
    -------
    View
        Its inverse depth is the inverse distance along the ray of a pixel.
    """
    lines = np.asarray(0.5 * np.arange(2 * (camera.width if by_columns else camera.height)) - 0.25, float)
    frames = frame_of(lines)
    different, which = np.unique(frames, return_inverse=True)
    poses: Floats = np.stack([world_from_cam(float(frame)) for frame in different])
    cam_from_world = np.asarray(np.linalg.inv(poses)[which], np.float64)
    depth_samples = np.zeros((2 * camera.height, 2 * camera.width), np.float32)
    id_samples = np.full(depth_samples.shape, NOTHING, np.int16)
    seen = {}
    for i, quad in enumerate(quads):
        found = _see(quad, camera, by_columns, frames, cam_from_world)
        if found is not None:
            seen[i], facing = found
            _fill(seen[i], facing, i, depth_samples, id_samples)
    return shade(len(quads), seen, depth_samples, id_samples)


def _see(
    quad: Quad, camera: LensCamera, by_columns: bool, frames: Floats, cam_from_world: Floats
) -> tuple[_SeenRays, Bools] | None:
    """Find the window of a quad, and the lines (2 L,) in which its visible side faces the camera."""
    R, t = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    if quad.moves:
        cam_from_texel = R @ np.stack([quad.world_from_texel(float(frame)) for frame in frames])
    else:
        cam_from_texel = R @ quad.world_from_texel(0.0)
    cam_from_texel[:, :, 2] += t
    distance = np.linalg.det(cam_from_texel) / quad.texel_area
    facing = (distance if quad.one_sided else np.abs(distance)) > _EDGE_ON_M
    if not facing.any():
        return None
    # A line in which the quad is edge-on has no inverse; it is not drawn there.
    texel_from_ray = np.asarray(np.linalg.inv(np.where(facing[:, None, None], cam_from_texel, np.eye(3))))
    size = np.array([quad.texture.width - 1, quad.texture.height - 1], float)
    boxes = [
        _box(camera, size, cam_from_texel[k], texel_from_ray[k])
        for k in (round(instant * (len(frames) - 1)) for instant in _INSTANTS)
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
    return _SeenRays(quad, camera, by_columns, texel_from_ray, rows, columns), facing


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


def _fill(seen: _SeenRays, facing: Bools, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer."""
    part = seen.rows, seen.columns
    rays = sample_rays(seen.camera, 2)[part]
    lines = part[1] if seen.by_columns else part[0]
    # Matrices and lines are broadcast along the samples of a line.
    G = np.expand_dims(seen.texel_from_ray[lines], 0 if seen.by_columns else 1)
    drawn = np.expand_dims(facing[lines], 0 if seen.by_columns else 1)

    def value(row: int) -> Floats32:
        first, second, third = (G[..., row, q] * rays[..., q] for q in range(3))
        return np.asarray(first + second + third, np.float32)

    inverse_distance = value(2)
    window = depth_samples[part]
    wins = (inverse_distance > window) & (inverse_distance < 1 / NEAR_M) & drawn
    for row, size in ((0, seen.quad.texture.width - 1), (1, seen.quad.texture.height - 1)):
        scaled = value(row)
        wins &= (scaled >= 0) & (scaled <= np.float32(size) * inverse_distance)
    np.copyto(window, inverse_distance, where=wins)
    np.copyto(id_samples[part], np.int16(identity), where=wins)
