"""The compiled step of a joint fit: how the tracks and the poses follow a step of the common unknowns."""

from __future__ import annotations

import numpy as np

from quest.robust.kernels.small_algebra import tangents, turn
from slam_init.types.arrays import Bools, Floats
from slam_init.window.compiler import compiled
from slam_init.window.projection import project_point

#: A change of the lens that moves the pixels of a ray to first order by less than a hundredth.
_LEAST_CHANGE = 1e-3
#: Newton's method starts at the ray to first order; with two steps the pixel is exact to a thousandth.
_NEWTON_STEPS = 2


@compiled
def _through_lens(
    camera: Floats, lens: Floats, stretched: float, bent: float, ray: Floats, r0: float, r1: float, r2: float
) -> tuple[float, float, float]:
    """The ray of a pixel through a new lens; the ray to first order (r0, r1, r2) where there is none."""
    scale, k1 = np.exp(lens[0]), lens[1]
    seen, x, y, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(camera, scale, k1, ray[0], ray[1], ray[2])
    if not seen:
        return r0, r1, r2
    d0, d1, d2 = r0 - ray[0], r1 - ray[1], r2 - ray[2]
    x += a0 * d0 + a1 * d1 + a2 * d2 + (x - camera[3]) * stretched + f0 * bent
    y += b0 * d0 + b1 * d1 + b2 * d2 + (y - camera[4]) * stretched + f1 * bent
    scale, k1 = scale * np.exp(stretched), k1 + bent
    n0, n1, n2 = r0, r1, r2
    for _ in range(_NEWTON_STEPS):
        seen, u, v, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(camera, scale, k1, n0, n1, n2)
        # The shortest step: the ray does not move along itself.
        aa, ab, bb = a0 * a0 + a1 * a1 + a2 * a2, a0 * b0 + a1 * b1 + a2 * b2, b0 * b0 + b1 * b1 + b2 * b2
        det = aa * bb - ab * ab
        if not seen or det <= 0.0:
            return r0, r1, r2
        e0, e1 = (bb * (x - u) - ab * (y - v)) / det, (aa * (y - v) - ab * (x - u)) / det
        n0, n1, n2 = n0 + a0 * e0 + b0 * e1, n1 + a1 * e0 + b1 * e1, n2 + a2 * e0 + b2 * e1
    return n0, n1, n2


@compiled
def step_tracks(
    back: Floats,
    coupled: Floats,
    length: float,
    rays: Floats,
    rho: Floats,
    free: Bools,
    on_plane: Bools,
    camera: Floats,
    lens: Floats,
    by_lens: Floats,
) -> tuple[Floats, Floats]:
    """How the rays and inverse distances of the tracks follow a step of the common unknowns.

    A pixel of the anchor is measured, and its ray follows the lens. To first order it would leave its pixel by the
    square of the step: by several pixels where the distortion moves by a tenth. So the pixel moves to first order, and
    the ray is that of the pixel through the new lens.

    Shapes: ``back`` (T, 3, 4 + G), ``coupled`` (T, 3), ``rays`` (T, 3), ``rho`` (T,), ``free, on_plane`` (T,),
    ``camera`` (31,), ``lens, by_lens`` (2,), returns ``rays, rho`` (T, 3).

    * ``coupled``: Product of the coupling and the step of the common unknowns: ``back[:, :, 4:] @ step``.
    * ``free, on_plane``: The inverse distance of a track is an unknown where it is free and not on the plane.
    * ``lens, by_lens``: Logarithm of the focal scale and k1, before the step, and their steps at length 1.
    """
    moved, lengths = np.empty_like(rays), np.empty_like(rho)
    bends = length * max(abs(by_lens[0]), abs(by_lens[1])) > _LEAST_CHANGE
    for i in range(len(rays)):
        own = back[i]
        g0, g1, g2 = own[0, 0] + coupled[i, 0], own[1, 0] + coupled[i, 1], own[2, 0] + coupled[i, 2]
        first = -length * (own[0, 1] * g0 + own[0, 2] * g1 + own[0, 3] * g2)
        second = -length * (own[1, 1] * g0 + own[1, 2] * g1 + own[1, 3] * g2)
        farther = -length * (own[2, 1] * g0 + own[2, 2] * g1 + own[2, 3] * g2)
        x0, x1, x2, y0, y1, y2 = tangents(rays[i])
        r0 = rays[i, 0] + first * x0 + second * y0
        r1 = rays[i, 1] + first * x1 + second * y1
        r2 = rays[i, 2] + first * x2 + second * y2
        if bends:
            r0, r1, r2 = _through_lens(camera, lens, length * by_lens[0], length * by_lens[1], rays[i], r0, r1, r2)
        norm = max(np.sqrt(r0 * r0 + r1 * r1 + r2 * r2), 1e-300)
        moved[i, 0], moved[i, 1], moved[i, 2] = r0 / norm, r1 / norm, r2 / norm
        lengths[i] = max(rho[i] + farther, 0.0) if free[i] and not on_plane[i] else max(rho[i], 0.0)
    return moved, lengths


@compiled
def step_poses(
    step: Floats, length: float, field_size: int, R: Floats, t: Floats, field: Floats
) -> tuple[Floats, Floats, Floats]:
    """The poses and the error fields after a step of the common unknowns.

    Shapes: ``step`` (G,), ``R, t`` (V, 3, 3), ``field`` (V, F), returns ``R, t, field`` (V, 3, 3).

    * ``field_size``: Coefficients of the error field of a view that are unknowns; 0 for none.
    """
    turned, moved, bent = R.copy(), t.copy(), field.copy()
    place = 0
    for k in range(len(R)):
        if k > 0:
            turn(turned[k], length * step[place], length * step[place + 1], length * step[place + 2])
            for q in range(3):
                moved[k, q] += length * step[place + 3 + q]
            place += 6
        for q in range(field_size):
            bent[k, q] += length * step[place + q]
        place += field_size
    return turned, moved, bent
