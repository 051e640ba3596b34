"""Epipolar geometry of bearings: two views obey ``u R m + t = v n``.

All functions take unit rays, so that views wider than 180 degrees are no special case. All functions take many
hypotheses (R, t) at once: with E = [t]x R the scalars ``n . E m`` of H hypotheses and N matches are one product of an
(H, 9) and a (9, N) matrix.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats

Floats = NDArray[np.float64]


def as_matches(m: ArrayLike, n: ArrayLike, at_least: int) -> tuple[Floats, Floats]:
    """Check matched bearings and scale them to unit norm.

    Shapes: ``m, n`` (N, 3), returns ``m, n`` (N, 3).
    """
    m, n = as_floats(m, "bearings"), as_floats(n, "bearings")
    if m.shape != n.shape or m.ndim not in (2, 3) or m.shape[-1] != 3:
        raise InputError(f"bearings of shape {m.shape} and {n.shape}: give two arrays of one shape (N, 3) or (B, N, 3)")
    if m.shape[-2] < at_least:
        raise InputError(f"{m.shape[-2]} matches in a sample: give at least {at_least}")
    if not (np.isfinite(m).all() and np.isfinite(n).all()):
        raise InputError("bearings hold a number that is not finite: remove those matches")
    return _unit(m), _unit(n)


def _unit(rays: Floats) -> Floats:
    """Rays (..., 3) of unit norm, whatever their scale: 1e300 overflows when squared, 1e-300 vanishes."""
    if not (np.abs(rays) < 1e100).all() or (np.abs(rays).max(axis=-1) < 1e-100).any():
        largest = np.abs(rays).max(axis=-1, keepdims=True)
        if not largest.all():
            raise InputError("a bearing is zero: it has no direction, remove that match")
        rays = rays / largest
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def sampson_error(R: ArrayLike, t: ArrayLike, m: ArrayLike, n: ArrayLike) -> Floats:
    """Signed Sampson errors of matches in radians; both views have the same weight.

    The error is, to first order, the smallest common tangential change of m and n after which the match fulfils the
    epipolar constraint ``n . E m = 0`` on the product of two unit spheres. For rays near the optical axis it is the
    usual Sampson error divided by the focal length. It stays finite and meaningful beyond 90 degrees from the axis.

    P. D. Sampson, "Fitting conic sections to very scattered data", CGIP 1982; on rays as in Hartley and
    Zisserman, "Multiple View Geometry", section 11.4.3.

    Shapes: ``R`` (..., 3, 3), ``t`` (..., 3), ``m, n`` (N, 3), returns (..., N).

    * Returns: Zero where the match lies on both epipoles: there every change fulfils the constraint.
    """
    R, t = np.asarray(R, float), np.asarray(t, float)
    E = np.cross((t / np.linalg.norm(t, axis=-1, keepdims=True))[..., :, None], R, axis=-2)
    m, n = np.asarray(m, float), np.asarray(n, float)
    residual = _flat(E) @ _outer(n, m)
    # |E m|^2 and |E^T n|^2 are quadratic forms in m and n; their part along the ray is the squared residual.
    r2 = residual**2
    squared = _squared_norms(E.swapaxes(-1, -2) @ E, m) + _squared_norms(E @ E.swapaxes(-1, -2), n) - 2 * r2
    # 1e-18 rad^2 is far below the noise of any camera; it avoids a division by zero for matches at the epipoles.
    return np.asarray(residual / np.sqrt(np.maximum(squared, 1e-18)))


def _squared_norms(forms: Floats, rays: Floats) -> Floats:
    """``ray . form ray`` of symmetric forms (..., 3, 3) and rays (..., N, 3): (..., N)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    products = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=-2)
    return np.asarray(forms[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] @ products)


def _flat(matrices: Floats) -> Floats:
    """Matrices (..., 3, 3) as rows (..., 9)."""
    return matrices.reshape(*matrices.shape[:-2], 9)


def _outer(n: Floats, m: Floats) -> Floats:
    """Outer products of rays (..., N, 3) as columns (..., 9, N): ``_flat(X) @ _outer(n, m)`` is n . X m."""
    products = n[..., :, None] * m[..., None, :]
    return products.reshape(*n.shape[:-1], 9).swapaxes(-1, -2)


def depths_from_pose(R: ArrayLike, t: ArrayLike, m: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats]:
    """Depths of matches along their rays for given poses: least squares of ``|u R m + t - v n|``.

    With ``c = (R m) . n`` the normal equations of each match are 2x2 and their solution is the midpoint of
    the common perpendicular of the two rays::

        u = (c (n . t) - (R m . t)) / (1 - c^2)        v = ((n . t) - c (R m . t)) / (1 - c^2)

    Shapes: ``R`` (..., 3, 3), ``t`` (..., 3), ``m, n`` (N, 3), returns ``u, v`` (..., N).

    * Returns ``u, v``: Depths in camera 1 and camera 2, negative for a point behind. Infinite or NaN for parallel rays.
    """
    R, t, m, n = (np.asarray(a, float) for a in (R, t, m, n))
    c = _flat(R) @ _outer(n, m)
    m_t = (t[..., None, :] @ R)[..., 0, :] @ m.swapaxes(-1, -2)  # (R m) . t = m . R^T t
    n_t = t @ n.swapaxes(-1, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        # (1 - c)(1 + c) keeps the digits of small angles that 1 - c^2 would lose.
        scale = 1 / ((1 - c) * (1 + c))
        return (c * n_t - m_t) * scale, (n_t - c * m_t) * scale


def tangent_basis(t: Floats) -> Floats:
    """Orthonormal bases of the planes orthogonal to vectors.

    Shapes: ``t`` (..., 3), returns (..., 3, 2).
    """
    helper = np.eye(3)[np.argmin(np.abs(t), axis=-1)]
    first = np.cross(t, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(t, first)
    return np.stack([first, second / np.linalg.norm(second, axis=-1, keepdims=True)], axis=-1)
