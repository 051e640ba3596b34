"""Rendering textured quads: exact homographies, mipmaps, and a depth buffer with four samples per pixel.

The texels of a quad map to pixels by the homography ``H = K cam_from_world [edge_u | edge_v | corner]``, so that a
world point and its texel project to exactly the same place (pixel centres at integers). The inverse depth of a plane is
affine in the pixel, which makes the depth buffer cheap and exact. Visibility is decided at four samples per pixel.
Colour is computed once per pixel and quad. A pixel on a silhouette is the mean of the quads, weighted by their visible
samples, as in a real lens.

With a rolling shutter or a lens each row of samples has its own pose (:func:`render_lines`). Its matrix G maps what a
sample sees to the texel of a quad: ``(s, t, 1) / depth``. Within half a row the camera does not move. With a readout of
30 ms and a motion of the image by 1500 px/s this is an error of 0.02 px at most for the silhouettes. For colours the
mean of both matrices of a row of pixels is used; its error is of second order.

* A pinhole camera: what a sample sees is its place. The matrix is the inverse of
  ``K cam_from_world(t_row) world_from_texel``.
* A lens of any field of view: what a sample sees is its ray d, which meets the plane of a quad at
  ``G d = (s, t, 1) / distance`` with ``G = (cam_from_world world_from_texel)^-1``. So the depth buffer holds the
  inverse distance along the ray, which is positive behind the image plane too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np

from sequences_synth.arrays import Bools, Floats, Floats32, Ids, Image, Ints
from sequences_synth.camera import Sights, SynthCamera, all_sights, sights_of
from sequences_synth.texture import Quad

#: The near plane in metres: a surface that is nearer would fill the view.
NEAR_M = 0.05
#: The id of a pixel that shows no quad.
NOTHING = -1
# A camera nearer than this (metres) to the plane of a quad sees the quad edge-on, and the quad is not rendered.
_EDGE_ON_M = 1e-6
# The level of detail is smooth. It is computed on a coarse grid with this many nodes per side, then interpolated.
_GRID = 16


@dataclass(frozen=True, eq=False)
class View:
    """One rendered view."""

    #: (H, W, 3) BGR, black where there is nothing.
    image: Image
    #: (H, W) 1 / z at the pixel centres, 0 where there is nothing.
    inverse_depth: Floats32
    #: (H, W) Position of the visible quad in the list, -1 where there is none.
    ids: Ids


@dataclass(frozen=True, eq=False)
class _Seen:
    """A quad in front of the camera: its homography, and its outline in pixels."""

    quad: Quad
    texel_from_pixel: Floats  # applied to (x, y, 1): (s, t, 1) / z
    outline: list[tuple[float, float]]  # convex

    def inverse_depth_at(self, x: Ints, y: Ints) -> Floats:
        return np.asarray(np.sum(self.texel_from_pixel[2] * np.column_stack([x, y, np.ones(len(x))]), axis=1))

    def window(self, width: int, height: int) -> tuple[slice, slice]:
        """Rows and columns that hold every pixel with a sample inside the outline; empty where it is outside."""
        columns, rows = (
            # Samples lie a quarter of a pixel from the centre; the margin of half a pixel contains them.
            slice(min(size, max(0, math.ceil(min(c) - 0.5))), max(0, min(size, math.floor(max(c) + 0.5) + 1)))
            for c, size in zip(zip(*self.outline, strict=True), (width, height), strict=True)
        )
        return rows, columns

    def sample(self, left: int, top: int, mask: Image) -> Image:
        import cv2

        height, width = mask.shape
        levels = self.quad.texture.levels
        into_window = np.array([[1, 0, left], [0, 1, top], [0, 0, 1]], float)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP

        def warp(level: int) -> Image:
            matrix = np.diag([0.5**level, 0.5**level, 1.0]) @ self.texel_from_pixel @ into_window
            warped = cv2.warpPerspective(
                levels[level], matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
            )
            return cast(Image, warped)

        return _blend_levels(self.quad, self._detail(left, top, width, height), mask, warp)

    def _detail(self, left: int, top: int, width: int, height: int) -> Floats32:
        x, y = _detail_nodes(left, top, width, height)
        G = self.texel_from_pixel
        p = np.stack([x, y, np.ones_like(x)], axis=-1) @ G.T
        w = p[..., 2]
        w = np.where(np.abs(w) < 1e-12 * np.abs(w).max(), 1e-12 * np.abs(w).max(), w)  # the horizon itself
        s, t = p[..., 0] / w, p[..., 1] / w
        sx, sy = (G[0, 0] - s * G[2, 0]) / w, (G[0, 1] - s * G[2, 1]) / w
        tx, ty = (G[1, 0] - t * G[2, 0]) / w, (G[1, 1] - t * G[2, 1]) / w
        return _level_of_detail(sx, sy, tx, ty)


def render(quads: Sequence[Quad], K: Floats, cam_from_world: Floats, width: int, height: int) -> View:
    """Render the quads.

    Shapes: ``K`` (3, 3), ``cam_from_world`` (4, 4).
    """
    seen = _project(quads, K, cam_from_world)
    depth_samples = np.zeros((2 * height, 2 * width), np.float32)
    id_samples = np.full((2 * height, 2 * width), NOTHING, np.int16)
    for i, s in seen.items():
        _fill(s, i, depth_samples, id_samples)
    return _shade(len(quads), seen, depth_samples, id_samples)


def _project(quads: Sequence[Quad], K: Floats, cam_from_world: Floats) -> dict[int, _Seen]:
    """Clip and project the quads, without those behind the camera and one-sided ones seen from behind."""
    R, t = cam_from_world[:3, :3], cam_from_world[:3, 3]
    cam_from_texel = R @ np.stack([quad.world_from_texel for quad in quads])
    cam_from_texel[:, :, 2] += t
    # The triple product u x v . corner is the distance to the plane times the area of a texel.
    facing = np.linalg.det(cam_from_texel)
    distance = facing / np.array([quad.texel_area for quad in quads])
    one_sided = np.array([quad.one_sided for quad in quads])
    visible = np.where(one_sided, distance, np.abs(distance)) > _EDGE_ON_M
    seen = {}
    for i in np.nonzero(visible)[0].tolist():
        w, h = quads[i].texture.width - 1, quads[i].texture.height - 1
        corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float) @ cam_from_texel[i].T
        if corners[:, 2].min() < NEAR_M:
            corners = _clip_near(corners)
        if len(corners) < 3:
            continue
        outline = [(x / z, y / z) for x, y, z in (corners @ K.T).tolist()]
        seen[i] = _Seen(quads[i], np.asarray(np.linalg.inv(K @ cam_from_texel[i]), float), outline)
    return seen


def _clip_near(polygon: Floats) -> Floats:
    """Cut a polygon (N, 3) at the near plane (Sutherland and Hodgman 1974); its part beyond, which may be empty."""
    kept = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] >= NEAR_M:
            kept.append(a)
        if (a[2] >= NEAR_M) != (b[2] >= NEAR_M):
            kept.append(a + (b - a) * ((NEAR_M - a[2]) / (b[2] - a[2])))
    return np.array(kept).reshape(-1, 3)


def _fill(seen: _Seen, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer, whose sample (i, j) lies at pixel (j / 2 - 1/4, i / 2 - 1/4)."""
    rows, columns = depth_samples.shape
    outline = [(2 * x + 0.5, 2 * y + 0.5) for x, y in seen.outline]
    top = max(0, math.ceil(min(y for _, y in outline)))
    bottom = min(rows, math.floor(max(y for _, y in outline)) + 1)
    if top >= bottom or max(x for x, _ in outline) < 0 or min(x for x, _ in outline) > columns - 1:
        return
    left, right = _spans(outline, top, bottom)
    first, last = max(0, math.ceil(left.min())), min(columns, math.floor(right.max()) + 1)
    if first >= last:
        return
    a, b, c = seen.texel_from_pixel[2]
    x = np.arange(first, last, dtype=np.float32)
    across = (a * (0.5 * x - 0.25)).astype(np.float32)
    down = (b * (0.5 * np.arange(top, bottom) - 0.25) + c).astype(np.float32)
    inverse_depth = down[:, None] + across
    window = depth_samples[top:bottom, first:last]
    wins = inverse_depth > window
    # A quad that fills the window on every row needs no test against its outline.
    if left.max() > first or right.min() < last - 1:
        wins &= x >= left[:, None].astype(np.float32)
        wins &= x <= right[:, None].astype(np.float32)
    np.copyto(window, inverse_depth, where=wins)
    np.copyto(id_samples[top:bottom, first:last], np.int16(identity), where=wins)


def _spans(outline: list[tuple[float, float]], top: int, bottom: int) -> tuple[Floats, Floats]:
    """First and last x of each row inside a convex outline; all rows, from ``top`` to before ``bottom``, cross it."""
    left, right = np.full(bottom - top, np.inf), np.full(bottom - top, -np.inf)
    for (xa, ya), (xb, yb) in zip(outline, outline[1:] + outline[:1], strict=True):
        first, last = max(top, math.ceil(min(ya, yb))), min(bottom, math.floor(max(ya, yb)) + 1)
        if ya == yb or first >= last:
            continue
        x = xa + (np.arange(first, last) - ya) * ((xb - xa) / (yb - ya))
        crossed = slice(first - top, last - top)
        np.minimum(left[crossed], x, out=left[crossed])
        np.maximum(right[crossed], x, out=right[crossed])
    return left, right


def _shade(
    count: int, seen: Mapping[int, _Seen] | Mapping[int, _LineQuad], depth_samples: Floats32, id_samples: Ids
) -> View:
    """Colour the visible parts of the quads.

    * ``seen``: The quads that may be visible, by their position in the list.
    """
    import cv2

    corners = [id_samples[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    ids = corners[0].copy()
    mixed = (corners[1] != ids) | (corners[2] != ids) | (corners[3] != ids)
    height, width = ids.shape
    # The mean of four samples of an affine function is its value at the pixel centre. On a silhouette the samples come
    # from several planes; there the plane of the first sample is evaluated at the pixel centre.
    inverse_depth = cast(Floats32, cv2.resize(depth_samples, (width, height), interpolation=cv2.INTER_AREA))
    y, x = np.nonzero(mixed)
    at_centre = np.zeros(len(x))
    first_ids = ids[y, x]
    for i in np.unique(first_ids[first_ids != NOTHING]).tolist():
        chosen = first_ids == i
        at_centre[chosen] = seen[i].inverse_depth_at(x[chosen], y[chosen])
    inverse_depth[y, x] = np.maximum(at_centre, 0)

    image: Image = np.zeros((height, width, 3), np.uint8)
    # The samples of the silhouette pixels, four per pixel, grouped by quad.
    side_ids = np.stack([corner[y, x] for corner in corners], axis=1).ravel()
    side_colors = np.zeros((len(side_ids), 3), np.float32)
    order = np.argsort(side_ids, kind="stable")
    starts = np.searchsorted(side_ids[order], np.arange(count + 1))
    for i, s in seen.items():
        window = s.window(width, height)
        own = (ids[window] == i).view(np.uint8)
        if own.size == 0:
            continue
        sides = order[starts[i] : starts[i + 1]]
        side_x, side_y = x[sides // 4], y[sides // 4]
        own[side_y - window[0].start, side_x - window[1].start] = 1
        left, top, w, h = cv2.boundingRect(own)
        if w == 0:
            continue
        own = own[top : top + h, left : left + w]
        left, top = left + window[1].start, top + window[0].start
        patch = s.sample(left, top, own)
        cv2.copyTo(patch, own, image[top : top + h, left : left + w])
        side_colors[sides] = patch[side_y - top, side_x - left]
    image[y, x] = np.round(side_colors.reshape(-1, 4, 3).mean(axis=1))
    return View(image, inverse_depth, ids)


def _blend_levels(quad: Quad, detail: Floats32, mask: Image, warp: Callable[[int], Image]) -> Image:
    """Blend the two levels of the texture that are next to the level of detail.

    Shapes: ``detail`` (16, 16), ``mask`` (H, W), returns (H, W, 3).

    * ``warp``: Number of a level -> that level as seen in the window, (H, W, 3) uint8.
    """
    import cv2

    height, width = mask.shape
    detail = np.clip(detail, 0, len(quad.texture.levels) - 1)
    # Outside the mask the plane may reach its horizon. The levels of detail there are not needed.
    used = detail[cv2.resize(255 * mask, (_GRID, _GRID), interpolation=cv2.INTER_AREA) > 0]
    if used.size:
        detail = np.clip(detail, used.min(), used.max())
    lowest, highest = int(np.floor(detail.min())), int(np.ceil(detail.max()))
    patch = warp(lowest)
    if highest > lowest:
        full_detail = cv2.resize(detail, (width, height), interpolation=cv2.INTER_LINEAR)
        for level in range(lowest + 1, highest + 1):
            weight = np.clip(full_detail - np.float32(level - 1), 0, 1)
            patch = cast(Image, cv2.blendLinear(patch, warp(level), 1 - weight, weight))
    return patch if quad.light == 1.0 else cast(Image, cv2.convertScaleAbs(patch, alpha=quad.light))


def _level_of_detail(sx: Floats, sy: Floats, tx: Floats, ty: Floats) -> Floats32:
    """Compute log2 of the number of texels that a pixel spans, by the derivatives of the texels (s, t) in x and y.

    The number is taken between the geometric mean and the longer side of the footprint of the pixel. The longer side
    alone blurs slanted surfaces more than a lens does; the geometric mean alone makes them flicker.
    """
    area = np.abs(sx * ty - sy * tx)
    longest = np.sqrt(np.maximum(sx * sx + tx * tx, sy * sy + ty * ty))
    with np.errstate(divide="ignore"):
        detail = 0.25 * np.log2(area) + 0.5 * np.log2(longest)
    return np.asarray(np.clip(detail, -10, 30), np.float32)


def _detail_nodes(left: int, top: int, width: int, height: int) -> tuple[Floats, Floats]:
    """Compute the pixels of a window at which the level of detail is evaluated.

    Shapes: returns ``x, y`` (16, 16).

    * Returns ``x, y``: Pixels; they lie where cv2.resize assumes them when it enlarges the grid to the window.
    """
    nodes = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(left + nodes * width - 0.5, top + nodes * height - 0.5)
    return x, y


# -- one pose per row ------------------------------------------------------------------------------


# The window of a quad is found by the sights of every sixteenth sample, and by as many points of the quad as this on
# each side, at the first, the middle and the last line of the readout. It is widened by as many samples: a part of a
# quad that all miss is smaller than the margin. A pinhole camera stretches near parts of a quad, and takes more points.
_NODE_STEP, _POINTS, _POINTS_OF_PINHOLE, _INSTANTS = 16, 9, 17, (0, 0.5, 1)


@dataclass(frozen=True, eq=False)
class _LineQuad:
    """A quad in view, with one matrix per row of samples."""

    quad: Quad
    camera: SynthCamera
    #: (L, 3, 3) The matrix of each row of samples.
    texel_from_sight: Floats
    #: rows, columns: Samples that may see the quad.
    rows: slice
    columns: slice

    def _points(self, lines: Ints, sights: Sights) -> Floats:
        """The texels (..., 3) of sights (...), by the matrices of their rows of pixels."""
        G = (0.5 * (self.texel_from_sight[0::2] + self.texel_from_sight[1::2]))[lines]
        u, v, w = (one[..., None] for one in sights)
        return np.asarray(G[..., 0] * u + G[..., 1] * v + G[..., 2] * w)

    def inverse_depth_at(self, x: Ints, y: Ints) -> Floats:
        """Compute the inverse depth of the plane of the quad at pixels (N,)."""
        u, v, w = (one[y, x] for one in all_sights(self.camera, 1))
        return np.asarray(self._points(y, (u, v, w))[..., 2])

    def window(self, width: int, height: int) -> tuple[slice, slice]:
        """Find the part of the image that may show the quad."""
        rows, columns = (
            slice(s.start // 2, min((s.stop + 1) // 2, n)) for s, n in ((self.rows, height), (self.columns, width))
        )
        return rows, columns

    def sample(self, left: int, top: int, mask: Image) -> Image:
        """Colour a window of the image: ``mask`` (H, W), returns (H, W, 3)."""
        height, width = mask.shape
        part = slice(top, top + height), slice(left, left + width)
        lines = np.arange(top, top + height)[:, None]
        u, v, w = (one[part] for one in all_sights(self.camera, 1))
        texels = _texels(self._points(lines, (u, v, w)))
        return _blend_levels(self.quad, self._detail(left, top, width, height), mask, partial(self._warp, *texels))

    def _warp(self, s: Floats, t: Floats, level: int) -> Image:
        import cv2

        # Far outside of the texture, where pixels are not used, the coordinates may overflow.
        map_s, map_t = (np.clip(0.5**level * c, -1e4, 1e4).astype(np.float32) for c in (s, t))
        texels = self.quad.texture.levels[level]
        return cast(Image, cv2.remap(texels, map_s, map_t, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _detail(self, left: int, top: int, width: int, height: int) -> Floats32:
        """Level of detail, by differences over one pixel."""
        x, y = _detail_nodes(left, top, width, height)
        last = len(self.texel_from_sight) // 2 - 1

        def texels(a: int, b: int) -> Floats:
            lines = np.clip(np.round(y + b).astype(int), 0, last)
            return np.stack(_texels(self._points(lines, sights_of(self.camera, x + a, y + b))))

        here = texels(0, 0)
        (sx, tx), (sy, ty) = texels(1, 0) - here, texels(0, 1) - here
        return _level_of_detail(sx, sy, tx, ty)

    def enter(self, facing: Bools, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
        """Enter the quad into the depth buffer."""
        part = self.rows, self.columns
        G, shown = self.texel_from_sight[self.rows][:, None], facing[self.rows][:, None]
        u, v, w = (one[part] for one in all_sights(self.camera, 2))

        def texels(row: int) -> Floats32:
            a, b, c = G[..., row, 0], G[..., row, 1], G[..., row, 2]
            if self.camera.is_pinhole:
                return np.asarray(a * u[:1] + (b * v[:, :1] + c), np.float32)
            return np.asarray(a * u + b * v + c * w, np.float32)

        inverse_depth = texels(2)
        window = depth_samples[part]
        wins = (inverse_depth > window) & (inverse_depth < 1 / NEAR_M) & shown
        for row, size in ((0, self.quad.texture.width - 1), (1, self.quad.texture.height - 1)):
            scaled = texels(row)
            wins &= (scaled >= 0) & (scaled <= np.float32(size) * inverse_depth)
        np.copyto(window, inverse_depth, where=wins)
        np.copyto(id_samples[part], np.int16(identity), where=wins)


def _texels(points: Floats) -> tuple[Floats, Floats]:
    w = np.where(np.abs(points[..., 2]) < 1e-12, 1e-12, points[..., 2])  # the horizon itself
    return points[..., 0] / w, points[..., 1] / w


def render_lines(
    quads: Sequence[Quad],
    camera: SynthCamera,
    frame_of: Callable[[Floats], Floats],
    world_from_cam: Callable[[float], Floats],
) -> View:
    """Render the quads with one pose per row.

    * ``frame_of``: Row of pixels, (N,) float -> frame number at which it is exposed, (N,) float.
    * Returns: Of a lens camera, its inverse depth is the inverse distance along the ray of a pixel.
    """
    frames = frame_of(0.5 * np.arange(2 * camera.height, dtype=np.float64) - 0.25)
    different, which = np.unique(frames, return_inverse=True)
    poses: Floats = np.stack([world_from_cam(float(frame)) for frame in different])
    cam_from_world = np.asarray(np.linalg.inv(poses)[which], np.float64)
    depth_samples = np.zeros((2 * camera.height, 2 * camera.width), np.float32)
    id_samples = np.full(depth_samples.shape, NOTHING, np.int16)
    seen = {}
    for i, quad in enumerate(quads):
        cam_from_texel = cam_from_world[:, :3, :3] @ quad.world_from_texel
        cam_from_texel[:, :, 2] += cam_from_world[:, :3, 3]
        distance = np.linalg.det(cam_from_texel) / quad.texel_area
        # Elsewhere the visible side of the quad does not face the camera, and the matrix may have no inverse.
        facing = (distance if quad.one_sided else np.abs(distance)) > _EDGE_ON_M
        found = _see(camera, quad, cam_from_texel, facing)
        if found is not None:
            seen[i] = found
            found.enter(facing, i, depth_samples, id_samples)
    return _shade(len(quads), seen, depth_samples, id_samples)


def _see(camera: SynthCamera, quad: Quad, cam_from_texel: Floats, facing: Bools) -> _LineQuad | None:
    """Find the window of a quad; None if it is not in view."""
    K = camera.K if camera.is_pinhole else np.eye(3)
    # A line in which the quad is edge-on has no inverse; it is not rendered there.
    texel_from_sight = np.asarray(np.linalg.inv(np.where(facing[:, None, None], K @ cam_from_texel, np.eye(3))))
    size = np.array([quad.texture.width - 1, quad.texture.height - 1], float)
    lines = (round(instant * (len(facing) - 1)) for instant in _INSTANTS)
    found = [_box(camera, size, cam_from_texel[k], texel_from_sight[k]) for k in lines if facing[k]]
    spots = np.concatenate([np.zeros((0, 2)), *found])
    if not len(spots):
        return None
    low, high = spots.min(axis=0) - _NODE_STEP, spots.max(axis=0) + _NODE_STEP + 1
    columns, rows = (
        slice(max(0, int(a)), min(2 * side, int(b)))
        for a, b, side in zip(low, high, (camera.width, camera.height), strict=True)
    )
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    return _LineQuad(quad, camera, texel_from_sight, rows, columns)


def _box(camera: SynthCamera, size: Floats, cam_from_texel: Floats, texel_from_sight: Floats) -> Floats:
    """Samples (N, 2), as column and row, that see a quad: of a coarse grid, and those of points of the quad."""
    nodes = np.stack([one[::_NODE_STEP, ::_NODE_STEP] for one in all_sights(camera, 2)], axis=-1)
    p = nodes @ texel_from_sight.T
    inside = (p[..., 2] > 0) & (p[..., :2] >= 0).all(axis=-1) & (p[..., :2] <= size * p[..., 2:]).all(axis=-1)
    rows, columns = np.nonzero(inside)
    count = _POINTS_OF_PINHOLE if camera.is_pinhole else _POINTS
    s, t = np.meshgrid(*(np.linspace(0, side, count) for side in size))
    points = np.column_stack([s.ravel(), t.ravel(), np.ones(s.size)]) @ cam_from_texel.T
    angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    pixels = camera.project(points[angle <= camera.half_field_rad])
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    return np.concatenate([_NODE_STEP * np.column_stack([columns, rows]).astype(float), 2 * pixels + 0.5])
