"""What the solvers for the essential matrix share: the epipolar equations, the cubic constraints, the rotations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import quaternion_from_matrix
from quest.solvers.quest6 import rotation_alone

__all__ = ["as_samples", "constraints", "finish", "null_space", "rotations_of_essential"]

Floats = NDArray[np.float64]

_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def as_samples(m: ArrayLike, n: ArrayLike, at_least: int, at_most: int | None = None) -> tuple[Floats, Floats, bool]:
    """Unit bearings (B, N, 3) of a solver's arguments, and whether they came as a single sample (N, 3).

    Raises
    ------
    InputError
        As :func:`quest.geometry.epipolar.as_matches`, and where N is larger than ``at_most``.
    """
    m, n = as_matches(m, n, at_least=at_least)
    if at_most is not None and m.shape[-2] > at_most:
        raise InputError(f"{m.shape[-2]} matches in a sample: give {at_most}")
    return (m[None], n[None], True) if m.ndim == 2 else (m, n, False)


def null_space(m: Floats, n: Floats, dimensions: int) -> Floats:
    """Orthonormal basis (B, dimensions, 3, 3) of the matrices E that fulfil ``n . E m = 0`` best, smallest last."""
    rows = (n[..., :, None] * m[..., None, :]).reshape(*m.shape[:2], 9)
    # R instead of the rows: the singular value decomposition is of nine rows at most.
    V = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2]
    return np.asarray(V[:, 9 - dimensions :].reshape(len(m), dimensions, 3, 3))


def constraints(E: Floats) -> Floats:
    """Ten cubics (..., 10) that vanish for essential matrices (..., 3, 3): ``2 E E'E - tr(E E') E`` and ``det E``."""
    EEt = E @ E.swapaxes(-1, -2)
    trace = np.trace(EEt, axis1=-2, axis2=-1)[..., None, None]
    nine = (2 * EEt @ E - trace * E).reshape(*E.shape[:-2], 9)
    return np.concatenate([nine, np.linalg.det(E)[..., None]], axis=-1)


def rotations_of_essential(E: Floats) -> Floats:
    """The two rotations (..., 2, 4) of essential matrices (..., 3, 3), which need not be exact; NaN for NaN.

    References
    ----------
    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 9.6.2.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(E).all(axis=(-1, -2)))
    U, _, Vt = np.linalg.svd(np.where(known[..., None, None], E, np.eye(3)))
    # The sign of E is free, and so are those of U and V: make both rotations.
    U = U * np.sign(np.linalg.det(U))[..., None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[..., None, None]
    R = np.stack([U @ _QUARTER_TURN @ Vt, U @ _QUARTER_TURN.T @ Vt], axis=-3)
    return np.where(known[..., None, None], quaternion_from_matrix(R), np.nan)


def finish(q: Floats, m: Floats, n: Floats, single: bool) -> Floats:
    """Candidates (B, K, 4) as a solver returns them.

    Where the camera has only turned, every translation fits, essential matrices are not determined, and the rotation
    that turns m into n takes the place of what a solver found: :func:`quest.solvers.quest6.rotation_alone`.
    """
    still = rotation_alone(m, n)
    turned = np.isfinite(still[:, 0])
    q[turned] = np.nan
    q[turned, 0] = still[turned]
    return q[0][np.isfinite(q[0, :, 0])] if single else q
