"""The compiled loop of the joint fit: residuals, their derivatives, and the elimination of the tracks.

It is written once for every hypothesis. A track is seen first by its anchor view ``a``. There it has a true unit ray
``d``, and an inverse distance ``rho`` along this ray, which is 0 at infinity. Its point, scaled by ``rho``, is in view
k ::

    P = R_k R_a^T (d - rho t_a) + rho t_k          R_k, t_k = cam_k_from_world

and the residual in units of the noise is, with the projection pi of the lens and a measured pixel x ::

    e = (pi(P; focal scale) - x) / sigma + F(x) c_k

``F(x) c_k`` is the smooth error field of view k: six polynomials of the image coordinates for each component, with
coefficients c_k. View 0 is a measurement like any other, so its rays have residuals too.

On a plane ``k . X = 1`` the inverse distance is no unknown: ``rho = (k . u) / (1 - k . c)`` with ``u = R_a^T d`` and
the centre ``c = -R_a^T t_a`` of the anchor. A point with ``rho <= 0`` lies behind its camera: all its observations
count as outliers then.

Each observation has the robust cost ``g e^2 / (g + e^2)`` (Geman and McClure), g the squared outlier gate. Each track
adds two or three unknowns of its own: two of its ray, and rho. They are eliminated by the Schur complement, track by
track, so that a step solves for the views, the focal length and the plane only. The order of the unknowns is: field of
view 0; pose (rotation vector, translation) and field of views 1, 2, ...; logarithm of the focal scale; plane.
"""

from __future__ import annotations

import numpy as np

from quest.robust.kernels.small_algebra import tangents
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled
from slam_init.window.projection import project_point

__all__ = ["FIELD_TERMS", "accumulate"]

#: Coefficients of the error field of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12


@compiled
def _depth_on_plane(R: Floats, t: Floats, a: int, d: Floats, plane: Floats, out: Floats) -> float:
    """Inverse distance of a ray; out (12,) receives its derivatives by plane, ray, rotation and translation."""
    u0 = R[a, 0, 0] * d[0] + R[a, 1, 0] * d[1] + R[a, 2, 0] * d[2]
    u1 = R[a, 0, 1] * d[0] + R[a, 1, 1] * d[1] + R[a, 2, 1] * d[2]
    u2 = R[a, 0, 2] * d[0] + R[a, 1, 2] * d[1] + R[a, 2, 2] * d[2]
    c0 = -(R[a, 0, 0] * t[a, 0] + R[a, 1, 0] * t[a, 1] + R[a, 2, 0] * t[a, 2])
    c1 = -(R[a, 0, 1] * t[a, 0] + R[a, 1, 1] * t[a, 1] + R[a, 2, 1] * t[a, 2])
    c2 = -(R[a, 0, 2] * t[a, 0] + R[a, 1, 2] * t[a, 1] + R[a, 2, 2] * t[a, 2])
    ku = plane[0] * u0 + plane[1] * u1 + plane[2] * u2
    den = 1.0 - (plane[0] * c0 + plane[1] * c1 + plane[2] * c2)
    f = ku / (den * den)
    out[0] = u0 / den + f * c0
    out[1] = u1 / den + f * c1
    out[2] = u2 / den + f * c2
    k0 = R[a, 0, 0] * plane[0] + R[a, 0, 1] * plane[1] + R[a, 0, 2] * plane[2]
    k1 = R[a, 1, 0] * plane[0] + R[a, 1, 1] * plane[1] + R[a, 1, 2] * plane[2]
    k2 = R[a, 2, 0] * plane[0] + R[a, 2, 1] * plane[1] + R[a, 2, 2] * plane[2]
    out[3] = k0 / den
    out[4] = k1 / den
    out[5] = k2 / den
    out[6] = (k1 * d[2] - k2 * d[1]) / den - f * (k1 * t[a, 2] - k2 * t[a, 1])
    out[7] = (k2 * d[0] - k0 * d[2]) / den - f * (k2 * t[a, 0] - k0 * t[a, 2])
    out[8] = (k0 * d[1] - k1 * d[0]) / den - f * (k0 * t[a, 1] - k1 * t[a, 0])
    out[9] = -f * k0
    out[10] = -f * k1
    out[11] = -f * k2
    return float(ku / den)


@compiled
def accumulate(
    camera: Floats,
    R: Floats,
    t: Floats,
    log_scale: float,
    plane: Floats,
    is_plane: bool,
    field: Floats,
    field_size: int,
    pixels: Floats,
    sigma_px: Floats,
    places: Floats,
    seen: Bools,
    anchor: Ints,
    d: Floats,
    rho: Floats,
    free: Bools,
    gate2: float,
    normal: Floats,
    gradient: Floats,
    back: Floats,
    costs: Floats,
    fill: bool,
) -> float:
    """Robust cost of all observations, and the equations of a Gauss-Newton step with the tracks eliminated.

    Parameters
    ----------
    camera : (11,) float
        Of :func:`slam_init.window.projection.camera_vector`.
    R, t : (V, 3, 3), (V, 3) float
        cam_from_world; view 0 is held.
    log_scale : float
        Logarithm of the focal scale.
    plane : (3,) float
        ``plane . X = 1`` in the world; used with ``is_plane``.
    is_plane : bool
        Whether the points lie on the plane.
    field : (V, 12) float
        Coefficients of the error fields.
    field_size : int
        12, or 0 for no field.
    pixels : (V, T, 2) float
        Measured pixels.
    sigma_px : (V, T) float
        Standard deviation of a coordinate of a pixel.
    places : (V, T, 6) float
        The polynomials of the field at the measured pixels, over sigma_px.
    seen : (V, T) bool
        Which view sees which track.
    anchor : (T,) int
        First view of a track; negative for a track that is left out.
    d : (T, 3) float
        Unit rays in the anchor's frame.
    rho : (T,) float
        Inverse distances along the rays.
    free : (T,) bool
        Tracks whose inverse distance is an unknown; the others are held.
    gate2 : float
        Squared outlier gate, in units of the noise.
    normal, gradient : (G, G), (G,) float
        Receive the equations.
    back : (T, 3, 4 + G) float
        Receives what the steps of the tracks need: gradient, inverse and coupling.
    costs : (T,) float
        Receives the cost of each track.
    fill : bool
        Whether the equations are wanted; otherwise only the costs.

    Returns
    -------
    float
        The sum of the costs.
    """
    V, T = seen.shape
    block = 6 + field_size
    views = block * (V - 1) + field_size  # view 0 has a field and no pose
    G = views + 1 + (3 if is_plane else 0)
    scale = np.exp(log_scale)
    pixel = np.empty(2)
    by_point = np.empty((2, 3))
    total = 0.0
    if fill:
        normal[:] = 0.0
        gradient[:] = 0.0
    idx = np.empty(2 * block + 16, np.int64)
    Jg = np.empty((2, 2 * block + 16))
    Jl = np.empty((2, 3))
    W = np.zeros((3, G))
    A = np.zeros((3, 3))
    b = np.zeros(3)
    AW = np.zeros((3, G))
    by = np.zeros(12)
    touched = np.zeros(G, np.bool_)
    columns = np.empty(G, np.int64)
    Y = np.empty(3)
    e = np.empty(2)
    D = np.empty((2, 3))
    DM = np.empty((2, 3))
    half = field_size // 2
    for i in range(T):
        costs[i] = 0.0
        a = anchor[i]
        if a < 0:
            continue
        r = rho[i]
        behind = False
        if is_plane:
            r = _depth_on_plane(R, t, a, d[i], plane, by)
            behind = r <= 0.0
        x0, x1, x2, y0, y1, y2 = tangents(d[i])
        v0, v1, v2 = d[i, 0] - r * t[a, 0], d[i, 1] - r * t[a, 1], d[i, 2] - r * t[a, 2]
        for q in range(3):
            Y[q] = R[a, 0, q] * v0 + R[a, 1, q] * v1 + R[a, 2, q] * v2
        W[:] = 0.0
        A[:] = 0.0
        b[:] = 0.0
        track = 0.0
        n_columns = 0
        for k in range(V):
            if not seen[k, i]:
                continue
            if behind:
                track += gate2
                continue
            p0 = R[k, 0, 0] * Y[0] + R[k, 0, 1] * Y[1] + R[k, 0, 2] * Y[2]
            p1 = R[k, 1, 0] * Y[0] + R[k, 1, 1] * Y[1] + R[k, 1, 2] * Y[2]
            p2 = R[k, 2, 0] * Y[0] + R[k, 2, 1] * Y[1] + R[k, 2, 2] * Y[2]
            P0, P1, P2 = p0 + r * t[k, 0], p1 + r * t[k, 1], p2 + r * t[k, 2]
            if not project_point(camera, scale, P0, P1, P2, pixel, by_point):
                track += gate2
                continue
            sigma = sigma_px[k, i]
            for j in range(2):
                e[j] = (pixel[j] - pixels[k, i, j]) / sigma
                if field_size:
                    for q in range(half):
                        e[j] += places[k, i, q] * field[k, j * half + q]
            r2 = e[0] * e[0] + e[1] * e[1]
            track += gate2 * r2 / (gate2 + r2)
            if not fill:
                continue
            weight = (gate2 / (gate2 + r2)) ** 2
            n = 0
            for j in range(2):
                for q in range(3):
                    D[j, q] = by_point[j, q] / sigma
            # R_a R_k^T D, the derivative by a point in the anchor's frame
            for j in range(2):
                w0 = D[j, 0] * R[k, 0, 0] + D[j, 1] * R[k, 1, 0] + D[j, 2] * R[k, 2, 0]
                w1 = D[j, 0] * R[k, 0, 1] + D[j, 1] * R[k, 1, 1] + D[j, 2] * R[k, 2, 1]
                w2 = D[j, 0] * R[k, 0, 2] + D[j, 1] * R[k, 1, 2] + D[j, 2] * R[k, 2, 2]
                for q in range(3):
                    DM[j, q] = w0 * R[a, q, 0] + w1 * R[a, q, 1] + w2 * R[a, q, 2]
            for j in range(2):
                Jl[j, 0] = DM[j, 0] * x0 + DM[j, 1] * x1 + DM[j, 2] * x2
                Jl[j, 1] = DM[j, 0] * y0 + DM[j, 1] * y1 + DM[j, 2] * y2
                Jl[j, 2] = 0.0
            if k != a:
                if k > 0:
                    o = field_size + block * (k - 1)
                    for q in range(6):
                        idx[n + q] = o + q
                    for j in range(2):
                        Jg[j, n] = p1 * D[j, 2] - p2 * D[j, 1]
                        Jg[j, n + 1] = p2 * D[j, 0] - p0 * D[j, 2]
                        Jg[j, n + 2] = p0 * D[j, 1] - p1 * D[j, 0]
                        for q in range(3):
                            Jg[j, n + 3 + q] = r * D[j, q]
                    n += 6
                if a > 0:
                    o = field_size + block * (a - 1)
                    for q in range(6):
                        idx[n + q] = o + q
                    for j in range(2):
                        Jg[j, n] = DM[j, 1] * v2 - DM[j, 2] * v1
                        Jg[j, n + 1] = DM[j, 2] * v0 - DM[j, 0] * v2
                        Jg[j, n + 2] = DM[j, 0] * v1 - DM[j, 1] * v0
                        for q in range(3):
                            Jg[j, n + 3 + q] = -r * DM[j, q]
                for j in range(2):
                    dr = 0.0
                    for q in range(3):
                        dr += D[j, q] * t[k, q] - DM[j, q] * t[a, q]
                    if is_plane:
                        Jl[j, 0] += dr * (by[3] * x0 + by[4] * x1 + by[5] * x2)
                        Jl[j, 1] += dr * (by[3] * y0 + by[4] * y1 + by[5] * y2)
                        if a > 0:
                            for q in range(6):
                                Jg[j, n + q] += dr * by[6 + q]
                        o = n + (6 if a > 0 else 0)
                        for q in range(3):
                            Jg[j, o + q] = dr * by[q]
                            idx[o + q] = views + 1 + q
                    elif free[i]:
                        Jl[j, 2] = dr
                if a > 0:
                    n += 6
                if is_plane:
                    n += 3
            if field_size:
                o = field_size + block * (k - 1) + 6 if k else 0
                for q in range(half):
                    idx[n + q] = o + q
                    idx[n + half + q] = o + half + q
                    Jg[0, n + q] = places[k, i, q]
                    Jg[1, n + q] = 0.0
                    Jg[0, n + half + q] = 0.0
                    Jg[1, n + half + q] = places[k, i, q]
                n += field_size
            idx[n] = views
            Jg[0, n] = (pixel[0] - camera[3]) / sigma
            Jg[1, n] = (pixel[1] - camera[4]) / sigma
            n += 1
            for j in range(2):
                for p in range(3):
                    x = weight * Jl[j, p]
                    b[p] += x * e[j]
                    for q in range(3):
                        A[p, q] += x * Jl[j, q]
            for p in range(n):
                column = idx[p]
                g0, g1 = weight * Jg[0, p], weight * Jg[1, p]
                gradient[column] += g0 * e[0] + g1 * e[1]
                for q in range(3):
                    W[q, column] += g0 * Jl[0, q] + g1 * Jl[1, q]
                if not touched[column]:
                    touched[column] = True
                    columns[n_columns] = column
                    n_columns += 1
                for q in range(n):
                    other = idx[q]
                    if other <= column:
                        normal[column, other] += g0 * Jg[0, q] + g1 * Jg[1, q]
        costs[i] = track
        total += track
        if not fill:
            continue
        unknowns = 2 if (is_plane or not free[i]) else 3
        for q in range(unknowns):
            A[q, q] = A[q, q] * (1 + 1e-9) + 1e-9
        if unknowns == 2:
            det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
            i00, i11, i01 = A[1, 1] / det, A[0, 0] / det, -A[0, 1] / det
            A[:] = 0.0
            A[0, 0], A[1, 1], A[0, 1], A[1, 0] = i00, i11, i01, i01
        else:
            c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
            c01 = A[1, 2] * A[0, 2] - A[0, 1] * A[2, 2]
            c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
            det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
            c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
            c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
            c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
            A[0, 0], A[1, 1], A[2, 2] = c00 / det, c11 / det, c22 / det
            A[0, 1] = A[1, 0] = c01 / det
            A[0, 2] = A[2, 0] = c02 / det
            A[1, 2] = A[2, 1] = c12 / det
        for p in range(3):
            back[i, p, 0] = b[p]
            for q in range(3):
                back[i, p, 1 + q] = A[p, q]
            for q in range(G):
                back[i, p, 4 + q] = 0.0
        for q in range(n_columns):
            column = columns[q]
            w0, w1, w2 = W[0, column], W[1, column], W[2, column]
            for p in range(3):
                back[i, p, 4 + column] = W[p, column]
                AW[p, column] = A[p, 0] * w0 + A[p, 1] * w1 + A[p, 2] * w2
            gradient[column] -= AW[0, column] * b[0] + AW[1, column] * b[1] + AW[2, column] * b[2]
            touched[column] = False
        for p in range(n_columns):
            column = columns[p]
            w0, w1, w2 = W[0, column], W[1, column], W[2, column]
            for q in range(n_columns):
                other = columns[q]
                if other <= column:
                    normal[column, other] -= w0 * AW[0, other] + w1 * AW[1, other] + w2 * AW[2, other]
    if fill:
        for p in range(G):
            for q in range(p):
                normal[q, p] = normal[p, q]
    return total
