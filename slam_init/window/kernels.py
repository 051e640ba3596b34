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

Let ``M`` be the derivatives of a residual by the point in the axes of the anchor, and ``v = d - rho t_a``. The
derivatives by the pose of view k, turned into the axes of the anchor, are ``M B`` with ``B = [-[v]x, rho I]``. Those by
the pose of the anchor are ``-M B``. ``B`` is the same in all views of a track. So each pair of anchor and view has sums
over its tracks (:mod:`slam_init.window.pair_sums`), which are turned into the view once.
"""

from __future__ import annotations

import numpy as np

from quest.robust.kernels.small_algebra import tangents
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled
from slam_init.window.pair_sums import assemble, pose_products, relative_poses
from slam_init.window.projection import project_point
from slam_init.window.track_equations import add_field, by_pose, clear_track, depth_on_plane, solve_track

#: An observation whose square is this many squared gates has no influence. With 3 the cost of a small residual is its
#: square.
TUKEY_GATES = 3.0


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
    observed: Floats,
    view: Ints,
    first: Ints,
    places: Floats,
    anchor: Ints,
    d: Floats,
    rho: Floats,
    free: Bools,
    gate2: float,
    normal: Floats,
    gradient: Floats,
    shares: Floats,
    back: Floats,
    halves: Floats,
    costs: Floats,
    residuals: Floats,
    across: Floats,
    fill: bool,
    hold: bool,
) -> float:
    """Robust cost of all observations, and the equations of a Gauss-Newton step.

    Shapes: ``camera`` (31,), ``R, t`` (V, 3, 3), ``plane`` (3,), ``on_plane`` (T,), ``field`` (V, 12), ``principal_px``
    (2,), ``observed`` (N, 9), ``view`` (N,), ``first`` (T + 1,), ``places`` (V, T, 6), ``anchor`` (T,), ``d`` (T, 3),
    ``rho`` (T,), ``free`` (T,), ``normal`` (G, G), ``gradient`` (G,), ``shares`` (T, G), ``back`` (T, 3, 4 + G),
    ``halves`` (T, 3, G + 1), ``costs`` (T,), ``residuals`` (V, T, 2), ``across`` (T,).

    * ``readout_s``: Readout in seconds, beyond the one that the pixels are corrected for.
    * ``observed``: The observations, track by track: measured pixel, one over the standard deviation in the direction
      in which the pixel is best known, the matrix that makes the noise equal in all directions (row by row, symmetric),
      and the derivative of the pixel by the readout. One record each, since reading them from arrays by view and track
      took as long as the arithmetic.
    * ``places``: The polynomials of the field at the measured pixels, over sigma_px.
    * ``anchor``: First view of a track; negative for a track that is left out.
    * ``free``: Tracks off the plane whose inverse distance is an unknown; those of the others are held. With ``hold``,
      tracks at infinity whose distance would become negative are held from here on.
    * ``normal``: Receives the lower half of the equations of the common unknowns, before the tracks are eliminated.
      With tracks on the plane the last three unknowns are those of the plane.
    * ``shares``: Receives the share of each track in the gradient, the track eliminated; empty where the shares are not
      wanted.
    * ``back``: Receives what the steps of the tracks need: gradient, inverse and coupling.
    * ``halves``: Receives what :func:`eliminate` needs: coupling and gradient of each track, over a root of its
      equations.
    * ``residuals``: Receives the residual of each observation in units of the noise; infinite behind a camera.
    * ``across``: Receives how much the cost of a track with a free distance would fall if its point moved across its
      epipolar lines, in proportion to what a distance moves it along them. A rigid scene does not move so: this is
      chance.
    """
    V, T = len(R), len(anchor)
    half = field_size // 2
    block = 6 + field_size
    focal = block * (V - 1) + field_size  # view 0 has a field and no pose
    lens = 2 + readout_size + principal_size
    at_plane, G = focal + lens, len(gradient)
    pairs = V if fill else 0
    turn, shift, pose_sums = np.empty((pairs, pairs, 9)), np.empty((pairs, pairs, 3)), np.zeros((pairs, pairs, 21))
    lens_sums, plane_sums = np.zeros((pairs, pairs, 5, 6)), np.zeros((pairs, pairs, 9, 6))
    if fill:
        for p in range(G):
            gradient[p] = 0.0
            for q in range(G):
                normal[p, q] = 0.0
        relative_poses(R, t, turn, shift)
    A, b, share, by_lens, Jc = np.zeros((3, 3)), np.zeros(3), np.zeros(G), np.zeros(5), np.zeros((2, 5))
    coupled, by_depth, rows, by = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 7)), np.zeros(12)
    total, focal_scale, flats, share_gate = 0.0, np.exp(log_scale), False, 1.0 / (TUKEY_GATES * gate2)
    for i in range(T):
        costs[i] = 0.0
        a = anchor[i]
        if fill:
            across[i] = 0.0
            clear_track(i, back, halves, shares, share, A, b, coupled, by_depth, by_lens)
        if a < 0:
            continue
        flat = on_plane[i]
        flats |= flat
        r = depth_on_plane(R, t, a, d[i], plane, by) if flat else rho[i]
        behind = flat and r <= 0.0
        x0, x1, x2, y0, y1, y2 = tangents(d[i])
        by_x, by_y = 0.0, 0.0
        if flat:
            by_x, by_y = by[3] * x0 + by[4] * x1 + by[5] * x2, by[3] * y0 + by[4] * y1 + by[5] * y2
        of_depth = 1.0 if free[i] and not flat else 0.0
        v0, v1, v2 = d[i, 0] - r * t[a, 0], d[i, 1] - r * t[a, 1], d[i, 2] - r * t[a, 2]
        Y0 = R[a, 0, 0] * v0 + R[a, 1, 0] * v1 + R[a, 2, 0] * v2
        Y1 = R[a, 0, 1] * v0 + R[a, 1, 1] * v1 + R[a, 2, 1] * v2
        Y2 = R[a, 0, 2] * v0 + R[a, 1, 2] * v1 + R[a, 2, 2] * v2
        E0, E1, E2, slope, curvature, depth_gradient, depth_curvature = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        cost = 0.0
        for n in range(first[i], first[i + 1]):
            k = view[n]
            z0 = R[k, 0, 0] * Y0 + R[k, 0, 1] * Y1 + R[k, 0, 2] * Y2
            z1 = R[k, 1, 0] * Y0 + R[k, 1, 1] * Y1 + R[k, 1, 2] * Y2
            z2 = R[k, 2, 0] * Y0 + R[k, 2, 1] * Y1 + R[k, 2, 2] * Y2
            sees, px, py, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(
                camera, focal_scale, k1, z0 + r * t[k, 0], z1 + r * t[k, 1], z2 + r * t[k, 2]
            )
            if behind or not sees:
                cost += gate2
                residuals[k, i, 0] = residuals[k, i, 1] = np.inf
                continue
            inverse = observed[n, 2]
            w00, w01, w10, w11 = observed[n, 3], observed[n, 4], observed[n, 5], observed[n, 6]
            g0 = (px + principal_px[0] + readout_s * observed[n, 7] - observed[n, 0]) * inverse
            g1 = (py + principal_px[1] + readout_s * observed[n, 8] - observed[n, 1]) * inverse
            for q in range(half):
                g0 += places[k, i, q] * field[k, q]
                g1 += places[k, i, q] * field[k, half + q]
            e0, e1 = w00 * g0 + w01 * g1, w10 * g0 + w11 * g1
            r2 = e0 * e0 + e1 * e1
            residuals[k, i, 0], residuals[k, i, 1] = e0, e1
            left = max(1.0 - r2 * share_gate, 0.0)
            cost += gate2 * (1.0 - left * left * left)
            if not fill or left == 0.0:
                continue
            weight = left * left
            # Derivatives by the point, in units of the noise: in the axes of the view, then in those of the anchor.
            w00, w01, w10, w11 = w00 * inverse, w01 * inverse, w10 * inverse, w11 * inverse
            a0, b0 = w00 * a0 + w01 * b0, w10 * a0 + w11 * b0
            a1, b1 = w00 * a1 + w01 * b1, w10 * a1 + w11 * b1
            a2, b2 = w00 * a2 + w01 * b2, w10 * a2 + w11 * b2
            c0 = a0 * turn[a, k, 0] + a1 * turn[a, k, 3] + a2 * turn[a, k, 6]
            c1 = a0 * turn[a, k, 1] + a1 * turn[a, k, 4] + a2 * turn[a, k, 7]
            c2 = a0 * turn[a, k, 2] + a1 * turn[a, k, 5] + a2 * turn[a, k, 8]
            d0 = b0 * turn[a, k, 0] + b1 * turn[a, k, 3] + b2 * turn[a, k, 6]
            d1 = b0 * turn[a, k, 1] + b1 * turn[a, k, 4] + b2 * turn[a, k, 7]
            d2 = b0 * turn[a, k, 2] + b1 * turn[a, k, 5] + b2 * turn[a, k, 8]
            # Derivatives by the ray and by the inverse distance, then weighted.
            s0, s1 = 0.0, 0.0
            if k != a:
                s0 = c0 * shift[a, k, 0] + c1 * shift[a, k, 1] + c2 * shift[a, k, 2]
                s1 = d0 * shift[a, k, 0] + d1 * shift[a, k, 1] + d2 * shift[a, k, 2]
            l00, l10 = c0 * x0 + c1 * x1 + c2 * x2 + s0 * by_x, d0 * x0 + d1 * x1 + d2 * x2 + s1 * by_x
            l01, l11 = c0 * y0 + c1 * y1 + c2 * y2 + s0 * by_y, d0 * y0 + d1 * y1 + d2 * y2 + s1 * by_y
            l02, l12 = s0 * of_depth, s1 * of_depth
            j00, j10 = weight * l00, weight * l10
            j01, j11 = weight * l01, weight * l11
            j02, j12 = weight * l02, weight * l12
            h0, h1 = weight * e0, weight * e1
            b[0] += l00 * h0 + l10 * h1
            b[1] += l01 * h0 + l11 * h1
            b[2] += l02 * h0 + l12 * h1
            A[0, 0] += j00 * l00 + j10 * l10
            A[1, 0] += j01 * l00 + j11 * l10
            A[1, 1] += j01 * l01 + j11 * l11
            A[2, 0] += j02 * l00 + j12 * l10
            A[2, 1] += j02 * l01 + j12 * l11
            A[2, 2] += j02 * l02 + j12 * l12
            slope += l02 * h1 - l12 * h0
            curvature += weight * (l02 * l02 + l12 * l12)
            # Derivatives by the lens.
            Jc[0, 0], Jc[1, 0], Jc[0, 1], Jc[1, 1] = px - camera[3], py - camera[4], f0, f1
            if readout_size:
                Jc[0, 2], Jc[1, 2] = observed[n, 7], observed[n, 8]
            if principal_size:
                Jc[0, lens - 2], Jc[1, lens - 2], Jc[0, lens - 1], Jc[1, lens - 1] = 1.0, 0.0, 0.0, 1.0
            for c in range(lens):
                g0, g1 = w00 * Jc[0, c] + w01 * Jc[1, c], w10 * Jc[0, c] + w11 * Jc[1, c]
                Jc[0, c], Jc[1, c] = g0, g1
                share[focal + c] += g0 * h0 + g1 * h1
                back[i, 0, 4 + focal + c] += j00 * g0 + j10 * g1
                back[i, 1, 4 + focal + c] += j01 * g0 + j11 * g1
                back[i, 2, 4 + focal + c] += j02 * g0 + j12 * g1
                g0, g1 = weight * g0, weight * g1
                for q in range(c + 1):
                    normal[focal + c, focal + q] += g0 * Jc[0, q] + g1 * Jc[1, q]
                if k != a:
                    m0, m1, m2 = c0 * g0 + d0 * g1, c1 * g0 + d1 * g1, c2 * g0 + d2 * g1
                    lens_sums[a, k, c, 0] += v1 * m2 - v2 * m1
                    lens_sums[a, k, c, 1] += v2 * m0 - v0 * m2
                    lens_sums[a, k, c, 2] += v0 * m1 - v1 * m0
                    lens_sums[a, k, c, 3] += r * m0
                    lens_sums[a, k, c, 4] += r * m1
                    lens_sums[a, k, c, 5] += r * m2
                    if flat:
                        by_lens[c] += s0 * g0 + s1 * g1
            if k != a:
                E0, E1, E2 = E0 + c0 * h0 + d0 * h1, E1 + c1 * h0 + d1 * h1, E2 + c2 * h0 + d2 * h1
                if a > 0:
                    coupled[0, 0] += j00 * c0 + j10 * d0
                    coupled[0, 1] += j00 * c1 + j10 * d1
                    coupled[0, 2] += j00 * c2 + j10 * d2
                    coupled[1, 0] += j01 * c0 + j11 * d0
                    coupled[1, 1] += j01 * c1 + j11 * d1
                    coupled[1, 2] += j01 * c2 + j11 * d2
                    coupled[2, 0] += j02 * c0 + j12 * d0
                    coupled[2, 1] += j02 * c1 + j12 * d1
                    coupled[2, 2] += j02 * c2 + j12 * d2
                m0, n0 = weight * c0, weight * d0
                m1, n1 = weight * c1, weight * d1
                m2, n2 = weight * c2, weight * d2
                sums = pose_products(
                    m0 * c0 + n0 * d0, m0 * c1 + n0 * d1, m0 * c2 + n0 * d2,
                    m1 * c1 + n1 * d1, m1 * c2 + n1 * d2, m2 * c2 + n2 * d2, v0, v1, v2, r,
                )  # fmt: skip
                pose_sums[a, k, 0] += sums[0]
                pose_sums[a, k, 1] += sums[1]
                pose_sums[a, k, 2] += sums[2]
                pose_sums[a, k, 3] += sums[3]
                pose_sums[a, k, 4] += sums[4]
                pose_sums[a, k, 5] += sums[5]
                pose_sums[a, k, 6] += sums[6]
                pose_sums[a, k, 7] += sums[7]
                pose_sums[a, k, 8] += sums[8]
                pose_sums[a, k, 9] += sums[9]
                pose_sums[a, k, 10] += sums[10]
                pose_sums[a, k, 11] += sums[11]
                pose_sums[a, k, 12] += sums[12]
                pose_sums[a, k, 13] += sums[13]
                pose_sums[a, k, 14] += sums[14]
                pose_sums[a, k, 15] += sums[15]
                pose_sums[a, k, 16] += sums[16]
                pose_sums[a, k, 17] += sums[17]
                pose_sums[a, k, 18] += sums[18]
                pose_sums[a, k, 19] += sums[19]
                pose_sums[a, k, 20] += sums[20]
                if flat:
                    # What moves the distance moves the point along s.
                    g0, g1 = weight * s0, weight * s1
                    m0, m1, m2 = c0 * g0 + d0 * g1, c1 * g0 + d1 * g1, c2 * g0 + d2 * g1
                    depth_gradient += s0 * h0 + s1 * h1
                    depth_curvature += g0 * s0 + g1 * s1
                    by_depth[0] += l00 * g0 + l10 * g1
                    by_depth[1] += l01 * g0 + l11 * g1
                    m0, m1, m2, n0, n1, n2 = (
                        v1 * m2 - v2 * m1,
                        v2 * m0 - v0 * m2,
                        v0 * m1 - v1 * m0,
                        r * m0,
                        r * m1,
                        r * m2,
                    )
                    for q in range(9 if a > 0 else 3):
                        c = by[q if q < 3 else q + 3]
                        plane_sums[a, k, q, 0] += m0 * c
                        plane_sums[a, k, q, 1] += m1 * c
                        plane_sums[a, k, q, 2] += m2 * c
                        plane_sums[a, k, q, 3] += n0 * c
                        plane_sums[a, k, q, 4] += n1 * c
                        plane_sums[a, k, q, 5] += n2 * c
                if k > 0:
                    at = field_size + block * (k - 1)
                    g0, g1 = z1 * a2 - z2 * a1, z1 * b2 - z2 * b1
                    share[at] = g0 * h0 + g1 * h1
                    back[i, 0, 4 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 4 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 4 + at] = j02 * g0 + j12 * g1
                    g0, g1 = z2 * a0 - z0 * a2, z2 * b0 - z0 * b2
                    share[at + 1] = g0 * h0 + g1 * h1
                    back[i, 0, 5 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 5 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 5 + at] = j02 * g0 + j12 * g1
                    g0, g1 = z0 * a1 - z1 * a0, z0 * b1 - z1 * b0
                    share[at + 2] = g0 * h0 + g1 * h1
                    back[i, 0, 6 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 6 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 6 + at] = j02 * g0 + j12 * g1
                    g0, g1 = r * a0, r * b0
                    share[at + 3] = g0 * h0 + g1 * h1
                    back[i, 0, 7 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 7 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 7 + at] = j02 * g0 + j12 * g1
                    g0, g1 = r * a1, r * b1
                    share[at + 4] = g0 * h0 + g1 * h1
                    back[i, 0, 8 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 8 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 8 + at] = j02 * g0 + j12 * g1
                    g0, g1 = r * a2, r * b2
                    share[at + 5] = g0 * h0 + g1 * h1
                    back[i, 0, 9 + at] = j00 * g0 + j10 * g1
                    back[i, 1, 9 + at] = j01 * g0 + j11 * g1
                    back[i, 2, 9 + at] = j02 * g0 + j12 * g1
            if field_size:
                rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3], rows[0, 4], rows[0, 5] = c0, c1, c2, l00, l01, l02
                rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3], rows[1, 4], rows[1, 5] = d0, d1, d2, l10, l11, l12
                rows[0, 6], rows[1, 6], rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3] = s0, s1, h0, h1, weight, r
                add_field(
                    n, k, i, a, flat, observed, places, rows, Jc, by, turn, v0, v1, v2, focal, lens, back, share, normal
                )
        costs[i] = cost
        total += cost
        if not fill:
            continue
        across[i] = slope * slope / curvature if curvature > 0.0 else 0.0
        if hold and r == 0.0 and not flat and b[2] > 0.0:
            free[i], b[2], coupled[2, 0], coupled[2, 1], coupled[2, 2] = False, 0.0, 0.0, 0.0, 0.0
            for q in range(G):
                back[i, 2, 4 + q] = 0.0
        at_a = field_size + block * (a - 1)
        if a > 0:
            by_anchor = by_pose(E0, E1, E2, v0, v1, v2, r)
            for q in range(6):
                share[at_a + q] = -by_anchor[q] + (depth_gradient * by[6 + q] if flat else 0.0)
            for p in range(3):
                by_anchor = by_pose(coupled[p, 0], coupled[p, 1], coupled[p, 2], v0, v1, v2, r)
                for q in range(6):
                    back[i, p, 4 + at_a + q] = -by_anchor[q] + (by_depth[p] * by[6 + q] if flat else 0.0)
        if flat:
            for p in range(3):
                share[at_plane + p] = depth_gradient * by[p]
                for q in range(3):
                    back[i, q, 4 + at_plane + p] = by_depth[q] * by[p]
                    normal[at_plane + p, at_plane + q] += depth_curvature * by[p] * by[q]
                for c in range(lens):
                    normal[at_plane + p, focal + c] += by[p] * by_lens[c]
            for q in range(6 if a > 0 else 0):
                for p in range(6):
                    normal[at_a + p, at_a + q] += depth_curvature * by[6 + p] * by[6 + q]
                for p in range(3):
                    normal[at_plane + p, at_a + q] += depth_curvature * by[p] * by[6 + q]
                for c in range(lens):
                    normal[focal + c, at_a + q] += by_lens[c] * by[6 + q]
        unknowns = 2 if (flat or not free[i]) else 3
        solve_track(i, A, b, unknowns, back, halves)
        for q in range(G):
            gradient[q] += share[q]
        if len(shares):
            for q in range(G):
                own = halves[i, 0, q] * halves[i, 0, G] + halves[i, 1, q] * halves[i, 1, G]
                shares[i, q] = share[q] - own - halves[i, 2, q] * halves[i, 2, G]
    if fill:
        assemble(turn, pose_sums, lens_sums, plane_sums, field_size, lens, flats, normal)
    return total
