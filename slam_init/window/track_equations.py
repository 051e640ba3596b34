"""The equations of one track in the joint fit: the parts of :func:`slam_init.window.kernels.accumulate`."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled

#: Coefficients of the error field of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12


@compiled
def collect(
    pixels: Floats,
    sigma_px: Floats,
    whitening: Floats,
    sweep_px_s: Floats,
    seen: Bools,
    anchor: Ints,
    observed: Floats,
    view: Ints,
    first: Ints,
) -> None:
    """Collect the observations of the tracks that take part, track by track.

    Shapes: ``pixels, sigma_px, whitening, sweep_px_s`` (V, T, 2), ``seen`` (V, T), ``anchor`` (T,), ``observed, view,
    first`` (N, 9).

    * ``observed, view, first``: Receive the arguments of :func:`slam_init.window.kernels.accumulate`.
    """
    V, T = seen.shape
    n = 0
    for i in range(T):
        first[i] = n
        for k in range(V):
            if anchor[i] < 0 or not seen[k, i]:
                continue
            view[n] = k
            observed[n, 0], observed[n, 1], observed[n, 2] = pixels[k, i, 0], pixels[k, i, 1], 1.0 / sigma_px[k, i]
            observed[n, 3], observed[n, 4] = whitening[k, i, 0, 0], whitening[k, i, 0, 1]
            observed[n, 5], observed[n, 6] = whitening[k, i, 1, 0], whitening[k, i, 1, 1]
            observed[n, 7], observed[n, 8] = sweep_px_s[k, i, 0], sweep_px_s[k, i, 1]
            n += 1
    first[T] = n


@compiled
def depth_on_plane(R: Floats, t: Floats, a: int, d: Floats, plane: Floats, out: Floats) -> float:
    """Inverse distance of a ray to a plane.

    Shapes: ``R, t`` (V, 3, 3), ``d`` (3,), ``plane`` (3,), ``out`` (12,).

    * ``out``: Receives the derivatives by the plane, by the ray, and by the rotation and the translation of the view.
    """
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
def by_pose(
    m0: float, m1: float, m2: float, v0: float, v1: float, v2: float, r: float
) -> tuple[float, float, float, float, float, float]:
    """Turn a derivative by the point into one by a pose: ``B^T m`` (:mod:`slam_init.window.pair_sums`)."""
    return v1 * m2 - v2 * m1, v2 * m0 - v0 * m2, v0 * m1 - v1 * m0, r * m0, r * m1, r * m2


@compiled
def add_field(
    n: int,
    k: int,
    i: int,
    a: int,
    flat: bool,
    observed: Floats,
    places: Floats,
    rows: Floats,
    Jc: Floats,
    by: Floats,
    turn: Floats,
    v0: float,
    v1: float,
    v2: float,
    focal: int,
    lens: int,
    back: Floats,
    share: Floats,
    normal: Floats,
) -> None:
    """Add what an observation tells of the error field of its view, alone and with the other unknowns.

    Shapes: ``observed`` (N, 9), ``places`` (V, T, 6), ``rows`` (3, 7), ``Jc`` (2, 5), ``by`` (12,), ``turn`` (V, V, 9),
    ``back, share, normal`` (T, 3, 4 + G).

    * ``rows``: The first two hold the derivatives by the point in the axes of the anchor (3), by the unknowns of the
      track (3) and by the inverse distance. The third holds the weighted residual (2), the weight and rho.
    * ``focal, lens``: Place of the focal length, and number of unknowns of the lens.
    """
    half, block = FIELD_TERMS // 2, 6 + FIELD_TERMS
    first = FIELD_TERMS + block * (k - 1) + 6 if k > 0 else 0
    h0, h1, weight, r = rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3]
    for p in range(FIELD_TERMS):
        f0, f1 = (
            observed[n, 3 + p // half] * places[k, i, p % half],
            observed[n, 5 + p // half] * places[k, i, p % half],
        )
        share[first + p] += f0 * h0 + f1 * h1
        g0, g1 = weight * f0, weight * f1
        for q in range(3):
            back[i, q, 4 + first + p] = g0 * rows[0, 3 + q] + g1 * rows[1, 3 + q]
        for q in range(p + 1):
            f0, f1 = observed[n, 3 + q // half], observed[n, 5 + q // half]
            normal[first + p, first + q] += (g0 * f0 + g1 * f1) * places[k, i, q % half]
        for c in range(lens):
            normal[focal + c, first + p] += g0 * Jc[0, c] + g1 * Jc[1, c]
        if k == a:
            continue
        m0, m1, m2 = (
            g0 * rows[0, 0] + g1 * rows[1, 0], g0 * rows[0, 1] + g1 * rows[1, 1], g0 * rows[0, 2] + g1 * rows[1, 2],
        )  # fmt: skip
        depth = g0 * rows[0, 6] + g1 * rows[1, 6]
        turned = by_pose(m0, m1, m2, v0, v1, v2, r)
        if a > 0:
            for q in range(6):
                by_anchor = -turned[q] + (depth * by[6 + q] if flat else 0.0)
                normal[first + p, FIELD_TERMS + block * (a - 1) + q] += by_anchor
        for q in range(3 if flat else 0):
            normal[focal + lens + q, first + p] += depth * by[q]
        for q in range(6 if k > 0 else 0):
            of, at = 3 * (q // 3), 3 * (q % 3)
            by_view = turn[a, k, at] * turned[of] + turn[a, k, at + 1] * turned[of + 1]
            normal[first + p, first - 6 + q] += by_view + turn[a, k, at + 2] * turned[of + 2]


@compiled
def clear_track(
    i: int,
    back: Floats,
    halves: Floats,
    shares: Floats,
    share: Floats,
    A: Floats,
    b: Floats,
    coupled: Floats,
    by_depth: Floats,
    by_lens: Floats,
) -> None:
    """Set the equations of a track to zero.

    Shapes: ``back, halves, shares`` (T, 3, 4 + G), ``share, A, b, coupled, by_depth, by_lens`` (G,).
    """
    for q in range(len(share)):
        share[q] = 0.0
    for q in range(len(share) if len(shares) else 0):
        shares[i, q] = 0.0
    for q in range(5):
        by_lens[q] = 0.0
    for p in range(3):
        b[p], by_depth[p] = 0.0, 0.0
        for q in range(3):
            A[p, q], coupled[p, q] = 0.0, 0.0
        for q in range(back.shape[2]):
            back[i, p, q] = 0.0
        for q in range(halves.shape[2]):
            halves[i, p, q] = 0.0


@compiled
def solve_track(i: int, A: Floats, b: Floats, unknowns: int, back: Floats, halves: Floats) -> None:
    """Invert the equations of a track.

    Shapes: ``A`` (3, 3), ``b`` (3,), ``back`` (T, 3, 4 + G), ``halves`` (T, 3, G + 1).

    * ``back``: Holds the coupling W in the last columns; receives b and the inverse.
    """
    G = back.shape[2] - 4
    for q in range(unknowns):
        A[q, q] = A[q, q] * (1 + 1e-9) + 1e-9
    i0 = 1.0 / np.sqrt(A[0, 0])
    l10, l20, l21, i2 = A[1, 0] * i0, 0.0, 0.0, 0.0
    i1 = 1.0 / np.sqrt(A[1, 1] - l10 * l10)
    if unknowns == 3:
        l20 = A[2, 0] * i0
        l21 = (A[2, 1] - l20 * l10) * i1
        i2 = 1.0 / np.sqrt(A[2, 2] - l20 * l20 - l21 * l21)
    for q in range(G):
        first = i0 * back[i, 0, 4 + q]
        second = i1 * (back[i, 1, 4 + q] - l10 * first)
        halves[i, 0, q], halves[i, 1, q], halves[i, 2, q] = (
            first,
            second,
            i2 * (back[i, 2, 4 + q] - l20 * first - l21 * second),
        )
    first = i0 * b[0]
    second = i1 * (b[1] - l10 * first)
    halves[i, 0, G], halves[i, 1, G], halves[i, 2, G] = first, second, i2 * (b[2] - l20 * first - l21 * second)
    # The rows of L^-1; the inverse is the sum of their outer products.
    m10 = -l10 * i0 * i1
    m20, m21 = -(l20 * i0 + l21 * m10) * i2, -l21 * i1 * i2
    back[i, 0, 0], back[i, 1, 0], back[i, 2, 0] = b[0], b[1], b[2]
    back[i, 0, 1], back[i, 1, 2], back[i, 2, 3] = i0 * i0 + m10 * m10 + m20 * m20, i1 * i1 + m21 * m21, i2 * i2
    back[i, 0, 2] = back[i, 1, 1] = m10 * i1 + m20 * m21
    back[i, 0, 3] = back[i, 2, 1] = m20 * i2
    back[i, 1, 3] = back[i, 2, 2] = m21 * i2


def eliminate(normal: Floats, gradient: Floats, halves: Floats) -> None:
    """Take the tracks out of the common equations, in place (Schur complement).

    It is one product of a matrix with itself, for which the linear algebra library of numpy is several times as fast as
    a loop.

    Shapes: ``normal`` (G, G), ``gradient`` (G,), ``halves`` (T, 3, G + 1).

    * ``normal``: Of :func:`slam_init.window.kernels.accumulate`, the lower half; receives all of the equations.
    """
    rows = halves.reshape(-1, halves.shape[2])
    _take_out(normal, gradient, rows.T @ rows)


@compiled
def _take_out(normal: Floats, gradient: Floats, taken: Floats) -> None:
    """Subtract (G + 1, G + 1) from the lower half of the equations and from the gradient, and fill the upper half."""
    size = len(gradient)
    for p in range(size):
        gradient[p] -= taken[p, size]
        for q in range(p):
            normal[p, q] -= taken[p, q]
            normal[q, p] = normal[p, q]
        normal[p, p] -= taken[p, p]
