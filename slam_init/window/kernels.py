"""The compiled loop of the joint fit: residuals, their derivatives, and the elimination of the tracks.

It is written once for every hypothesis. A track is seen first by its anchor view ``a``. There it has a true unit ray
``d``, and an inverse distance ``rho`` along this ray, which is 0 at infinity. Its point, scaled by ``rho``, is in view
k ::

    P = R_k R_a^T (d - rho t_a) + rho t_k          R_k, t_k = cam_k_from_world

and the residual in units of the noise is, with the projection pi of the lens and a measured pixel x ::

    e = W ((pi(P; focal scale, k1) + p + S r - x) / sigma + F(x) c_k)

``F(x) c_k`` is the smooth error field of view k: six polynomials of the image coordinates for each component, with
coefficients c_k. View 0 is a measurement like any other, so its rays have residuals too.

``r`` is the readout of a rolling shutter in seconds, and ``S`` how far the pixel moves for each second of it
(:mod:`slam_init.frontend.rolling_shutter`). The poses are those of the middle of the readout. ``p`` is the error of the
principal point, where it is unknown. ``W`` makes the noise of a pixel equal in all directions: a track slides along the
trails of a blurred image.

On a plane ``k . X = 1`` the inverse distance of a track is no unknown: ``rho = (k . u) / (1 - k . c)`` with ``u =
R_a^T d`` and the centre ``c = -R_a^T t_a`` of the anchor. A point with ``rho <= 0`` lies behind its camera: all its
observations count as outliers then.

Each observation has the robust cost ``g (1 - (1 - e^2 / 3g)^3)`` up to ``e^2 = 3g``, and g beyond (Tukey's biweight), g
the squared outlier gate. Near 0 it is e^2, and 95 % of the information of Gaussian noise is kept at a gate of three
standard deviations; the kernel of Geman and McClure with the same cost of an outlier keeps 57 %. Each track
adds two or three unknowns of its own: two of its ray, and rho. :func:`eliminate` takes them out (Schur complement), so
that a step solves for the views, the camera and the plane only. The order of the unknowns is: field of view 0; pose
(rotation vector, translation) and field of views 1, 2, ...; logarithm of the focal scale; k1, which is added to the
first coefficient of the radial distortion; readout, where it is unknown; principal point, where it is unknown; plane.
"""

from __future__ import annotations

import numpy as np

from quest.robust.kernels.small_algebra import tangents
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled
from slam_init.window.projection import project_point

__all__ = ["FIELD_TERMS", "TUKEY_GATES", "accumulate", "eliminate", "step_tracks"]

#: Coefficients of the error field of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12
#: An observation whose square is this many squared gates has no influence. With 3 the cost of a small residual is its
#: square.
TUKEY_GATES = 3.0


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
def _by_anchor_point(D: Floats, R: Floats, k: int, a: int, DM: Floats) -> None:
    """Turn derivatives by a point of view k (2, 3) into derivatives by a point of the anchor: ``DM = D R_k R_a^T``."""
    for j in range(2):
        w0 = D[j, 0] * R[k, 0, 0] + D[j, 1] * R[k, 1, 0] + D[j, 2] * R[k, 2, 0]
        w1 = D[j, 0] * R[k, 0, 1] + D[j, 1] * R[k, 1, 1] + D[j, 2] * R[k, 2, 1]
        w2 = D[j, 0] * R[k, 0, 2] + D[j, 1] * R[k, 1, 2] + D[j, 2] * R[k, 2, 2]
        for q in range(3):
            DM[j, q] = w0 * R[a, q, 0] + w1 * R[a, q, 1] + w2 * R[a, q, 2]


@compiled
def _pose_columns(first: int, x: Floats, r: float, D: Floats, sign: float, idx: Ints, Jg: Floats, n: int) -> int:
    """Derivatives by a pose: ``sign (x X D)`` by its rotation vector, ``sign r D`` by its translation."""
    for q in range(6):
        idx[n + q] = first + q
    for j in range(2):
        Jg[j, n] = sign * (x[1] * D[j, 2] - x[2] * D[j, 1])
        Jg[j, n + 1] = sign * (x[2] * D[j, 0] - x[0] * D[j, 2])
        Jg[j, n + 2] = sign * (x[0] * D[j, 1] - x[1] * D[j, 0])
        for q in range(3):
            Jg[j, n + 3 + q] = sign * r * D[j, q]
    return n + 6


@compiled
def _depth_columns(
    t: Floats,
    k: int,
    a: int,
    D: Floats,
    DM: Floats,
    on_plane: bool,
    free: bool,
    by: Floats,
    d: Floats,
    first: int,
    Jl: Floats,
    idx: Ints,
    Jg: Floats,
    n: int,
) -> int:
    """Derivatives by the inverse distance: of a free point, or through the plane, the ray and the anchor's pose."""
    x0, x1, x2, y0, y1, y2 = tangents(d)
    for j in range(2):
        by_depth = 0.0
        for q in range(3):
            by_depth += D[j, q] * t[k, q] - DM[j, q] * t[a, q]
        if on_plane:
            Jl[j, 0] += by_depth * (by[3] * x0 + by[4] * x1 + by[5] * x2)
            Jl[j, 1] += by_depth * (by[3] * y0 + by[4] * y1 + by[5] * y2)
            for q in range(6 if a > 0 else 0):
                Jg[j, n - 6 + q] += by_depth * by[6 + q]
            for q in range(3):
                Jg[j, n + q] = by_depth * by[q]
                idx[n + q] = first + q
        elif free:
            Jl[j, 2] = by_depth
    return n + (3 if on_plane else 0)


@compiled
def _field_columns(first: int, half: int, place: Floats, w: Floats, idx: Ints, Jg: Floats, n: int) -> int:
    """Derivatives by the error field of a view."""
    for q in range(half):
        idx[n + q] = first + q
        idx[n + half + q] = first + half + q
        for j in range(2):
            Jg[j, n + q] = w[j, 0] * place[q]
            Jg[j, n + half + q] = w[j, 1] * place[q]
    return n + 2 * half


@compiled
def _add_observation(
    weight: float,
    e: Floats,
    Jl: Floats,
    Jg: Floats,
    idx: Ints,
    n: int,
    A: Floats,
    b: Floats,
    W: Floats,
    share: Floats,
    normal: Floats,
) -> None:
    """Add an observation to the equations of its track (A, b, W) and to the common ones; the lower half of normal."""
    for j in range(2):
        for p in range(3):
            x = weight * Jl[j, p]
            b[p] += x * e[j]
            for q in range(3):
                A[p, q] += x * Jl[j, q]
    for p in range(n):
        column = idx[p]
        g0, g1 = weight * Jg[0, p], weight * Jg[1, p]
        share[column] += g0 * e[0] + g1 * e[1]
        for q in range(3):
            W[q, column] += g0 * Jl[0, q] + g1 * Jl[1, q]
        for q in range(n):
            other = idx[q]
            if other <= column:
                normal[column, other] += g0 * Jg[0, q] + g1 * Jg[1, q]


@compiled
def _invert(A: Floats, unknowns: int) -> None:
    """Invert the equations of a track in place; without its inverse distance where it has two unknowns."""
    for q in range(unknowns):
        A[q, q] = A[q, q] * (1 + 1e-9) + 1e-9
    if unknowns == 2:
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        i00, i11, i01 = A[1, 1] / det, A[0, 0] / det, -A[0, 1] / det
        A[:] = 0.0
        A[0, 0], A[1, 1], A[0, 1], A[1, 0] = i00, i11, i01, i01
        return
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


@compiled
def accumulate(
    camera: Floats,
    R: Floats,
    t: Floats,
    log_scale: float,
    k1: float,
    plane: Floats,
    on_plane: Bools,
    field: Floats,
    field_size: int,
    readout_s: float,
    readout_size: int,
    principal_px: Floats,
    principal_size: int,
    sweep_px_s: Floats,
    pixels: Floats,
    sigma_px: Floats,
    whitening: Floats,
    places: Floats,
    seen: Bools,
    anchor: Ints,
    d: Floats,
    rho: Floats,
    free: Bools,
    gate2: float,
    normal: Floats,
    shares: Floats,
    back: Floats,
    costs: Floats,
    residuals: Floats,
    across: Floats,
    fill: bool,
    hold: bool,
) -> float:
    """Robust cost of all observations, and the equations of a Gauss-Newton step.

    Parameters
    ----------
    camera : (31,) float
        Of :func:`slam_init.window.projection.camera_vector`.
    R, t : (V, 3, 3), (V, 3) float
        cam_from_world; view 0 is held.
    log_scale : float
        Logarithm of the focal scale.
    k1 : float
        Added to the first coefficient of the radial distortion.
    plane : (3,) float
        ``plane . X = 1`` in the world.
    on_plane : (T,) bool
        Tracks whose point lies on the plane.
    field : (V, 12) float
        Coefficients of the error fields.
    field_size : int
        12, or 0 for no field.
    readout_s : float
        Readout in seconds, beyond the one that the pixels are corrected for.
    readout_size : int
        1, or 0 where it is known.
    principal_px : (2,) float
        Added to the principal point.
    principal_size : int
        2, or 0 where it is known.
    sweep_px_s : (V, T, 2) float
        Derivatives of the pixels by the readout.
    pixels : (V, T, 2) float
        Measured pixels.
    sigma_px : (V, T) float
        Standard deviation of a pixel in the direction in which it is best known.
    whitening : (V, T, 2, 2) float
        Symmetric; makes the noise equal in all directions.
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
        Tracks off the plane whose inverse distance is an unknown; those of the others are held. With ``hold``, tracks
        at infinity whose distance would become negative are held from here on.
    gate2 : float
        Squared outlier gate, in units of the noise.
    normal : (G, G) float
        Receives the equations of the common unknowns, before the tracks are eliminated. With tracks on the plane the
        last three unknowns are those of the plane.
    shares : (T, G) float
        Receives the share of each track in their gradient.
    back : (T, 3, 4 + G) float
        Receives what the steps of the tracks need: gradient, inverse and coupling.
    costs : (T,) float
        Receives the cost of each track.
    residuals : (V, T, 2) float
        Receives the residual of each observation in units of the noise; infinite behind a camera.
    across : (T,) float
        Receives how much the cost of a track with a free distance would fall if its point moved across its epipolar
        lines, in proportion to what a distance moves it along them. A rigid scene does not move so: this is chance.
    fill : bool
        Whether the equations are wanted; otherwise only the costs.
    hold : bool
        Whether tracks at infinity are held there, see ``free``.

    Returns
    -------
    float
        The sum of the costs.
    """
    V, T = seen.shape
    half = field_size // 2
    block = 6 + field_size
    focal = block * (V - 1) + field_size  # view 0 has a field and no pose
    plane_first = focal + 2 + readout_size + principal_size
    G = shares.shape[1]
    if fill:
        normal[:], shares[:] = 0.0, 0.0
    idx, Jg, Jl = np.empty(2 * block + 17, np.int64), np.zeros((2, 2 * block + 17)), np.zeros((2, 3))
    A, b, W = np.zeros((3, 3)), np.zeros(3), np.zeros((3, G))
    D, DM, pixel, e = np.empty((2, 3)), np.empty((2, 3)), np.empty(2), np.empty(2)
    by_k1 = np.empty(2)
    by, v, Y, x = np.zeros(12), np.empty(3), np.empty(3), np.empty(3)
    total, focal_scale = 0.0, np.exp(log_scale)
    for i in range(T):
        costs[i] = 0.0
        a = anchor[i]
        if a < 0:
            if fill:
                back[i], across[i] = 0.0, 0.0
            continue
        r = _depth_on_plane(R, t, a, d[i], plane, by) if on_plane[i] else rho[i]
        behind = on_plane[i] and r <= 0.0
        x0, x1, x2, y0, y1, y2 = tangents(d[i])
        for q in range(3):
            v[q] = d[i, q] - r * t[a, q]
        for q in range(3):
            Y[q] = R[a, 0, q] * v[0] + R[a, 1, q] * v[1] + R[a, 2, q] * v[2]
        W[:], A[:], b[:] = 0.0, 0.0, 0.0
        slope, curvature = 0.0, 0.0
        for k in range(V):
            if not seen[k, i]:
                continue
            for q in range(3):
                x[q] = R[k, q, 0] * Y[0] + R[k, q, 1] * Y[1] + R[k, q, 2] * Y[2]
            P0, P1, P2 = x[0] + r * t[k, 0], x[1] + r * t[k, 1], x[2] + r * t[k, 2]
            if behind or not project_point(camera, focal_scale, k1, P0, P1, P2, pixel, D, by_k1):
                costs[i] += gate2
                residuals[k, i] = np.inf
                continue
            for j in range(2):
                predicted = pixel[j] + principal_px[j] + readout_s * sweep_px_s[k, i, j]
                e[j] = (predicted - pixels[k, i, j]) / sigma_px[k, i]
                for q in range(half):
                    e[j] += places[k, i, q] * field[k, j * half + q]
            w = whitening[k, i]
            e[0], e[1] = w[0, 0] * e[0] + w[0, 1] * e[1], w[1, 0] * e[0] + w[1, 1] * e[1]
            r2 = e[0] * e[0] + e[1] * e[1]
            residuals[k, i, 0], residuals[k, i, 1] = e[0], e[1]
            left = max(1.0 - r2 / (TUKEY_GATES * gate2), 0.0)
            costs[i] += gate2 * (1.0 - left * left * left)
            if not fill:
                continue
            for q in range(3):
                D0, D1 = D[0, q] / sigma_px[k, i], D[1, q] / sigma_px[k, i]
                D[0, q], D[1, q] = w[0, 0] * D0 + w[0, 1] * D1, w[1, 0] * D0 + w[1, 1] * D1
            _by_anchor_point(D, R, k, a, DM)
            n = 0
            for j in range(2):
                Jl[j, 0] = DM[j, 0] * x0 + DM[j, 1] * x1 + DM[j, 2] * x2
                Jl[j, 1] = DM[j, 0] * y0 + DM[j, 1] * y1 + DM[j, 2] * y2
                Jl[j, 2] = 0.0
            if k != a:
                if k > 0:
                    n = _pose_columns(field_size + block * (k - 1), x, r, D, 1.0, idx, Jg, n)
                if a > 0:
                    n = _pose_columns(field_size + block * (a - 1), v, r, DM, -1.0, idx, Jg, n)
                n = _depth_columns(t, k, a, D, DM, on_plane[i], free[i], by, d[i], plane_first, Jl, idx, Jg, n)
            if field_size:
                n = _field_columns(field_size + block * (k - 1) + 6 if k else 0, half, places[k, i], w, idx, Jg, n)
            camera_columns = n
            idx[n] = focal
            Jg[0, n] = (pixel[0] - camera[3]) / sigma_px[k, i]
            Jg[1, n] = (pixel[1] - camera[4]) / sigma_px[k, i]
            idx[n + 1] = focal + 1
            Jg[0, n + 1], Jg[1, n + 1] = by_k1[0] / sigma_px[k, i], by_k1[1] / sigma_px[k, i]
            n += 2
            if readout_size:
                idx[n] = focal + 2
                Jg[0, n] = sweep_px_s[k, i, 0] / sigma_px[k, i]
                Jg[1, n] = sweep_px_s[k, i, 1] / sigma_px[k, i]
                n += 1
            for q in range(principal_size):
                idx[n] = focal + 2 + readout_size + q
                Jg[q, n], Jg[1 - q, n] = 1.0 / sigma_px[k, i], 0.0
                n += 1
            for q in range(camera_columns, n):
                Jg[0, q], Jg[1, q] = w[0, 0] * Jg[0, q] + w[0, 1] * Jg[1, q], w[1, 0] * Jg[0, q] + w[1, 1] * Jg[1, q]
            slope += left * left * (Jl[0, 2] * e[1] - Jl[1, 2] * e[0])
            curvature += left * left * (Jl[0, 2] * Jl[0, 2] + Jl[1, 2] * Jl[1, 2])
            _add_observation(left * left, e, Jl, Jg, idx, n, A, b, W, shares[i], normal)
        total += costs[i]
        if fill:
            across[i] = slope * slope / curvature if curvature > 0.0 else 0.0
            if hold and r == 0.0 and not on_plane[i] and b[2] > 0.0:
                free[i], b[2], W[2] = False, 0.0, 0.0
            _invert(A, 2 if (on_plane[i] or not free[i]) else 3)
            # Not by slices: their assignment takes the compiler three seconds.
            for p in range(3):
                back[i, p, 0] = b[p]
                for q in range(3):
                    back[i, p, 1 + q] = A[p, q]
                for q in range(G):
                    back[i, p, 4 + q] = W[p, q]
    for p in range(G if fill else 0):
        for q in range(p):
            normal[q, p] = normal[p, q]
    return total


@compiled
def step_tracks(
    back: Floats, step: Floats, length: float, rays: Floats, rho: Floats, free: Bools
) -> tuple[Floats, Floats]:
    """How the rays and inverse distances of the tracks follow a step of the common unknowns.

    Parameters
    ----------
    back : (T, 3, 4 + G) float
        Of :func:`accumulate`.
    step : (G,) float
        Of the common unknowns.
    length : float
        Factor on the steps of all unknowns.
    rays : (T, 3) float
        Unit rays.
    rho : (T,) float
        Inverse distances.
    free : (T,) bool
        Tracks whose inverse distance is an unknown.

    Returns
    -------
    rays, rho : (T, 3), (T,) float
        Unit rays, and inverse distances that are not negative.
    """
    moved, lengths = np.empty_like(rays), np.empty_like(rho)
    g, local = np.empty(3), np.empty(3)
    for i in range(len(rays)):
        for p in range(3):
            g[p] = back[i, p, 0]
            for q in range(len(step)):
                g[p] += back[i, p, 4 + q] * step[q]
        for p in range(3):
            local[p] = -length * (back[i, p, 1] * g[0] + back[i, p, 2] * g[1] + back[i, p, 3] * g[2])
        x0, x1, x2, y0, y1, y2 = tangents(rays[i])
        r0 = rays[i, 0] + local[0] * x0 + local[1] * y0
        r1 = rays[i, 1] + local[0] * x1 + local[1] * y1
        r2 = rays[i, 2] + local[0] * x2 + local[1] * y2
        norm = max(np.sqrt(r0 * r0 + r1 * r1 + r2 * r2), 1e-300)
        moved[i, 0], moved[i, 1], moved[i, 2] = r0 / norm, r1 / norm, r2 / norm
        lengths[i] = max(rho[i] + local[2], 0.0) if free[i] else max(rho[i], 0.0)
    return moved, lengths


def eliminate(normal: Floats, shares: Floats, back: Floats) -> Floats:
    """Take the tracks out of the common equations, in place (Schur complement).

    It is one product of matrices, for which the linear algebra library of numpy is several times as fast as a loop.

    Parameters
    ----------
    normal : (G, G) float
        Of :func:`accumulate`.
    shares : (T, G) float
        Of :func:`accumulate`.
    back : (T, 3, 4 + G) float
        Of :func:`accumulate`.

    Returns
    -------
    (G,) float
        The gradient: the sum of the shares.
    """
    size = len(normal)
    coupling = back[:, :, 4:]
    solved = back[:, :, 1:4] @ coupling
    normal -= solved.reshape(-1, size).T @ coupling.reshape(-1, size)
    shares -= np.einsum("tpg,tp->tg", solved, back[:, :, 0])
    return np.asarray(shares.sum(axis=0))
