"""Rendering textured quads: exact homographies, mipmaps, a depth buffer with four samples a pixel.

A quad's texels map to pixels by the homography ``H = K cam_from_world [edge_u | edge_v | corner]``, so a world point
lands exactly where its texel does (pixel centres at integers). Inverse depth is affine in the pixel on a plane, which
makes the depth buffer cheap and exact. Visibility is decided at four samples a pixel, colour once a pixel and quad;
pixels on silhouettes mix the quads by the samples they won, as a lens would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.quad import Quad

__all__ = ["View", "render"]

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Ids = NDArray[np.int16]

# Nothing is drawn nearer than this, metres: what is nearer would fill the view.
_NEAR_M = 0.05
_NOTHING = -1
# The level of detail is smooth: computed on a coarse grid of so many nodes a side, then interpolated.
_GRID = 24


@dataclass(frozen=True, eq=False)
class View:
    """One rendered view.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR, black where there is nothing.
    inverse_depth : (H, W) float32
        1 / z at the pixel centres, 0 where there is nothing.
    ids : (H, W) int16
        Position of the quad seen, -1 where there is none.
    """

    image: Image
    inverse_depth: Floats32
    ids: Ids


@dataclass(frozen=True, eq=False)
class _Seen:
    """A quad in front of the camera: homography and inverse depth, its outline in pixels."""

    pixel_from_texel: Floats
    inverse_depth: Floats  # (3,): dot with (x, y, 1)
    outline: Floats  # (N, 2) convex, pixels


def render(
    quads: Sequence[Quad], K: Floats, cam_from_world: Floats, frame: float, width: int, height: int
) -> View:
    """Render the quads.

    Parameters
    ----------
    quads : sequence of Quad
    K : (3, 3) float
        Calibration matrix.
    cam_from_world : (4, 4) float
    frame : float
        Frame number, for quads that move.
    width, height : int
        Image size in pixels.
    """
    seen = {i: s for i, quad in enumerate(quads) if (s := _see(quad, K, cam_from_world, frame)) is not None}
    depth_samples = np.zeros((2 * height, 2 * width), np.float32)
    id_samples = np.full((2 * height, 2 * width), _NOTHING, np.int16)
    for i, s in seen.items():
        _fill(s, i, depth_samples, id_samples)
    return _shade(quads, seen, depth_samples, id_samples)


def _see(quad: Quad, K: Floats, cam_from_world: Floats, frame: float) -> _Seen | None:
    """Clip a quad at the near plane and project it; None where nothing of it is in front."""
    R, t = cam_from_world[:3, :3], cam_from_world[:3, 3]
    texel = quad.world_from_texel(frame)
    cam_from_texel = np.column_stack([R @ texel[:, 0], R @ texel[:, 1], R @ texel[:, 2] + t])
    normal, point = R @ quad.normal, cam_from_texel[:, 2]
    distance = float(normal @ point)
    # Edge-on quads have no area; one-sided ones are invisible from behind (their normal then points at us).
    if abs(distance) < 1e-9 or (quad.one_sided and distance < 0):
        return None
    w, h = quad.texture.width - 1, quad.texture.height - 1
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float) @ cam_from_texel.T
    corners = _clip_near(corners)
    if len(corners) < 3:
        return None
    projected = corners @ K.T
    inverse_depth = np.asarray(np.linalg.solve(K.T, normal / distance), float)  # n . X = distance, X = z K^-1 (x, y, 1)
    return _Seen(K @ cam_from_texel, inverse_depth, projected[:, :2] / projected[:, 2:])


def _clip_near(polygon: Floats) -> Floats:
    """Cut off what lies before the near plane (Sutherland and Hodgman 1974); (N, 3) camera points in and out."""
    kept = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] >= _NEAR_M:
            kept.append(a)
        if (a[2] >= _NEAR_M) != (b[2] >= _NEAR_M):
            kept.append(a + (b - a) * ((_NEAR_M - a[2]) / (b[2] - a[2])))
    return np.array(kept).reshape(-1, 3)


def _fill(seen: _Seen, identity: int, depth_samples: Floats32, id_samples: Ids) -> None:
    """Enter one quad into the depth buffer, whose sample (i, j) lies at pixel (j / 2 - 1/4, i / 2 - 1/4)."""
    rows, columns = depth_samples.shape
    outline = 2 * seen.outline + 0.5
    top = max(0, int(np.ceil(outline[:, 1].min())))
    bottom = min(rows, int(np.floor(outline[:, 1].max())) + 1)
    if top >= bottom:
        return
    left, right = _spans(outline, np.arange(top, bottom))
    first, last = max(0, int(np.ceil(left.min()))), min(columns, int(np.floor(right.max())) + 1)
    if first >= last:
        return
    a, b, c = seen.inverse_depth
    x = np.arange(first, last, dtype=np.float32)
    across = (a * (0.5 * x - 0.25)).astype(np.float32)
    down = (b * (0.5 * np.arange(top, bottom) - 0.25) + c).astype(np.float32)
    inverse_depth = down[:, None] + across
    window = depth_samples[top:bottom, first:last]
    wins = inverse_depth > window
    # Quads that fill the window on every row need no outline test.
    if left.max() > first or right.min() < last - 1:
        wins &= x >= left[:, None].astype(np.float32)
        wins &= x <= right[:, None].astype(np.float32)
    np.copyto(window, inverse_depth, where=wins)
    np.copyto(id_samples[top:bottom, first:last], np.int16(identity), where=wins)


def _spans(outline: Floats, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Where each row enters and leaves a convex outline; rows (N,) -> left, right (N,)."""
    left, right = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    for (xa, ya), (xb, yb) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if ya == yb:
            continue
        crossed = (rows >= min(ya, yb)) & (rows <= max(ya, yb))
        x = xa + (rows[crossed] - ya) * ((xb - xa) / (yb - ya))
        left[crossed] = np.minimum(left[crossed], x)
        right[crossed] = np.maximum(right[crossed], x)
    return left, right


def _shade(quads: Sequence[Quad], seen: dict[int, _Seen], depth_samples: Floats32, id_samples: Ids) -> View:
    """Colour what the depth buffer left visible."""
    import cv2

    corners = [id_samples[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    ids = corners[0].copy()
    mixed = (corners[1] != ids) | (corners[2] != ids) | (corners[3] != ids)
    height, width = ids.shape
    # The mean of four samples of an affine function is its value at the pixel centre; on a silhouette, where samples
    # come from several planes, the plane of the first sample is evaluated there.
    inverse_depth = cast(Floats32, cv2.resize(depth_samples, (width, height), interpolation=cv2.INTER_AREA))
    planes = np.zeros((len(quads) + 1, 3))
    for i, s in seen.items():
        planes[i] = s.inverse_depth
    y, x = np.nonzero(mixed)
    inverse_depth[y, x] = np.sum(planes[ids[y, x]] * np.column_stack([x, y, np.ones(len(x))]), axis=1)

    image: Image = np.zeros((height, width, 3), np.uint8)
    silhouette = np.zeros((len(x), 3), np.float32)
    sides = np.stack([corner[y, x] for corner in corners], axis=1)
    visible_ids = np.union1d(np.unique(ids), np.unique(sides))
    for i in visible_ids[visible_ids != _NOTHING].tolist():
        own = (ids == i).view(np.uint8)
        share = np.count_nonzero(sides == i, axis=1)
        touched = share > 0
        own[y[touched], x[touched]] = 1
        left, top, w, h = cv2.boundingRect(own)
        own = own[top : top + h, left : left + w]
        patch = _sample(quads[i], seen[i].pixel_from_texel, left, top, own)
        cv2.copyTo(patch, own, image[top : top + h, left : left + w])
        silhouette[touched] += 0.25 * share[touched, None] * patch[y[touched] - top, x[touched] - left]
    image[y, x] = np.round(silhouette)
    return View(image, inverse_depth, ids)


def _sample(quad: Quad, pixel_from_texel: Floats, left: int, top: int, mask: Image) -> Image:
    """The quad's texture as seen in a window of the image, trilinear: (height, width, 3) uint8.

    The mask (height, width) of the window tells where it will be used.
    """
    import cv2

    height, width = mask.shape
    levels = quad.texture.levels
    texel_from_pixel = np.asarray(np.linalg.inv(pixel_from_texel), float)
    detail = np.clip(_level_of_detail(texel_from_pixel, left, top, width, height), 0, len(levels) - 1)
    # Outside the mask the plane may run to its horizon, whose levels nobody needs.
    used = detail[cv2.resize(255 * mask, (_GRID, _GRID), interpolation=cv2.INTER_AREA) > 0]
    if used.size:
        detail = np.clip(detail, used.min(), used.max())
    lowest, highest = int(np.floor(detail.min())), int(np.ceil(detail.max()))
    into_window = np.array([[1, 0, left], [0, 1, top], [0, 0, 1]], float)

    def warp(level: int) -> Image:
        shrink = np.diag([0.5**level, 0.5**level, 1.0])
        matrix = shrink @ texel_from_pixel @ into_window
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cast(
            Image,
            cv2.warpPerspective(
                levels[level], matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
            ),
        )

    patch = warp(lowest)
    if highest > lowest:
        full_detail = cv2.resize(detail, (width, height), interpolation=cv2.INTER_LINEAR)
        for level in range(lowest + 1, highest + 1):
            weight = np.clip(full_detail - np.float32(level - 1), 0, 1)
            patch = cast(Image, cv2.blendLinear(patch, warp(level), 1 - weight, weight))
    return patch if quad.light == 1.0 else cast(Image, cv2.convertScaleAbs(patch, alpha=quad.light))


def _level_of_detail(texel_from_pixel: Floats, left: int, top: int, width: int, height: int) -> Floats32:
    """log2 of the texels that a pixel spans, on a coarse grid over a window.

    Between the geometric mean and the longer side of the pixel's footprint: the longer side alone blurs slanted
    surfaces more than a lens does, the mean alone lets them flicker.
    """
    # Nodes where cv2.resize puts them when it enlarges the grid to the window.
    nodes = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(left + nodes * width - 0.5, top + nodes * height - 0.5)
    G = texel_from_pixel
    p = np.stack([x, y, np.ones_like(x)], axis=-1) @ G.T
    w = p[..., 2]
    w = np.where(np.abs(w) < 1e-12 * np.abs(w).max(), 1e-12 * np.abs(w).max(), w)  # the horizon itself
    s, t = p[..., 0] / w, p[..., 1] / w
    sx, sy = (G[0, 0] - s * G[2, 0]) / w, (G[0, 1] - s * G[2, 1]) / w
    tx, ty = (G[1, 0] - t * G[2, 0]) / w, (G[1, 1] - t * G[2, 1]) / w
    area = np.abs(sx * ty - sy * tx)
    longest = np.sqrt(np.maximum(sx * sx + tx * tx, sy * sy + ty * ty))
    with np.errstate(divide="ignore"):
        detail = 0.25 * np.log2(area) + 0.5 * np.log2(longest)
    return np.asarray(np.clip(detail, -10, 30), np.float32)
