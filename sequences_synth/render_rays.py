"""Rendering through a lens of any field of view: each sample has its own ray, and each row its own pose.

A ray d meets the plane of a quad at ``G d = (s, t, 1) / distance`` with ``G = (cam_from_world world_from_texel)^-1``
and the texel (s, t). So the depth buffer holds the inverse distance along the ray, which is positive behind the image
plane too. There are two rows and two columns of samples per pixel, as in :mod:`sequences_synth.render`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.lens_camera import LensCamera, sample_rays
from sequences_synth.line_quad import LineQuad, cam_from_texel_of_lines, enter
from sequences_synth.render import NOTHING, View, shade
from sequences_synth.textured_quad import Quad

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ids = NDArray[np.int16]
Bools = NDArray[np.bool_]

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


def render_rays(
    quads: Sequence[Quad],
    camera: LensCamera,
    by_columns: bool,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads through a lens, with one pose per line.

    * ``by_columns``: Whether columns are exposed one after the other, and not rows.
    * ``frame_of``: Row (or column) of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    * Returns: Its inverse depth is the inverse distance along the ray of a pixel.
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
    cam_from_texel, facing = cam_from_texel_of_lines(quad, frames, cam_from_world)
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
    return _SeenRays(quad, by_columns, texel_from_ray, rows, columns, camera), facing


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
    rays = sample_rays(seen.camera, 2)[seen.rows, seen.columns]

    def value(G: Floats, row: int) -> Floats32:
        first, second, third = (G[..., row, q] * rays[..., q] for q in range(3))
        return np.asarray(first + second + third, np.float32)

    enter(seen, facing, identity, value, depth_samples, id_samples)
