"""Common parts of the solvers for the essential matrix: epipolar equations, cubic constraints, rotations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import quaternion_from_matrix
from quest.paper.quest6 import rotation_alone

Floats = NDArray[np.float64]

_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def as_samples(m: ArrayLike, n: ArrayLike, at_least: int, at_most: int | None = None) -> tuple[Floats, Floats, bool]:
    """Check the arguments of a solver.

    Shapes: ``m, n`` (N, 3), returns ``m, n`` (B, N, 3).
    """
    m, n = as_matches(m, n, at_least=at_least)
    if at_most is not None and m.shape[-2] > at_most:
        raise InputError(f"{m.shape[-2]} matches in a sample: give {at_most}")
    return (m[None], n[None], True) if m.ndim == 2 else (m, n, False)


def null_space(m: Floats, n: Floats, dimensions: int) -> Floats:
    """Basis of the matrices E that fulfil ``n . E m = 0`` best.

    Shapes: ``m, n`` (B, N, 3), returns (B, dimensions, 3, 3).
    """
    rows = (n[..., :, None] * m[..., None, :]).reshape(*m.shape[:2], 9)
    # R of a QR decomposition in place of the rows: the singular value decomposition is then of at most nine rows.
    V = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2]
    return np.asarray(V[:, 9 - dimensions :].reshape(len(m), dimensions, 3, 3))


def constraints(E: Floats) -> Floats:
    """Ten cubics that vanish for essential matrices: ``2 E E'E - tr(E E') E`` and ``det E``.

    Shapes: ``E`` (..., 3, 3), returns (..., 10).
    """
    EEt = E @ E.swapaxes(-1, -2)
    trace = np.trace(EEt, axis1=-2, axis2=-1)[..., None, None]
    nine = (2 * EEt @ E - trace * E).reshape(*E.shape[:-2], 9)
    return np.concatenate([nine, np.linalg.det(E)[..., None]], axis=-1)


def rotations_of_essential(E: Floats) -> Floats:
    """The two rotations of essential matrices.

    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 9.6.2.

    Shapes: ``E`` (..., 3, 3), returns (..., 2, 4).

    * ``E``: Any matrices: the nearest essential matrix is decomposed. NaN gives NaN.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(E).all(axis=(-1, -2)))
    U, _, Vt = np.linalg.svd(np.where(known[..., None, None], E, np.eye(3)))
    # The signs of E, U and V are free: choose the ones that make U and V rotations.
    U = U * np.sign(np.linalg.det(U))[..., None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[..., None, None]
    R = np.stack([U @ _QUARTER_TURN @ Vt, U @ _QUARTER_TURN.T @ Vt], axis=-3)
    return np.where(known[..., None, None], quaternion_from_matrix(R), np.nan)


def finish(q: Floats, m: Floats, n: Floats, single: bool) -> Floats:
    """Bring candidates into the form that a solver returns.

    For a rotation-only camera every translation fits and the essential matrix is not determined. The rotation that
    turns m into n (:func:`quest.paper.quest6.rotation_alone`) then replaces the candidates.

    Shapes: ``q`` (B, K, 4), ``m, n`` (B, N, 3), returns (B, K, 4).
    """
    rotation = rotation_alone(m, n)
    rotation_only = np.isfinite(rotation[:, 0])
    q[rotation_only] = np.nan
    q[rotation_only, 0] = rotation[rotation_only]
    return q[0][np.isfinite(q[0, :, 0])] if single else q
