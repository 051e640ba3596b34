"""The readable halves of the compiled parallax test of quest."""

from __future__ import annotations

from math import inf, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from quest.geometry.refine import sampson_jacobian, tangent_basis
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS

Floats = NDArray[np.float64]


def anisotropy_of(a: Floats, d: Floats, t: Floats) -> float:
    """The z of the module docstring, in plain numpy.

    Shapes: ``a`` (N, 3), ``d`` (N, 3), ``t`` (3,).
    """
    across = np.cross(a, t)
    length = np.linalg.norm(across, axis=1)
    some = length**2 > LEAST_SINE2
    a, d, across = a[some], d[some], across[some] / length[some, None]
    if len(a) < 4:
        return 0.0
    squares = np.einsum("ij,ij->i", d, d)
    spread = sqrt(0.5 * float(np.sum(np.maximum(squares, 1e-13**2) ** 2)))
    y = np.einsum("ij,ij->i", across, d)
    J = np.cross(a, across)  # across . (w x a) = w . (a x across)
    w = np.linalg.pinv(J.T @ J, rcond=1e-12, hermitian=True) @ (J.T @ y)
    total = squares.sum()
    rest = y - J @ w
    variance = total / (2 * len(a) - 3)
    return float(total - 2 * (rest @ rest) - 6 * variance) / spread


def typical_ratios(R: Floats, t: Floats, m: Floats, n: Floats) -> NDArray[np.bool_]:
    """The matches of which the mean ratio is taken: those within six median absolute deviations of the median.

    Shapes: ``R, t`` (3, 3), ``m, n`` (N, 3), returns (N,).
    """
    shift, sine2, _, _ = _shifts(R, t, m, n)
    known = sine2 > LEAST_SINE2
    if not known.any():
        return np.asarray(known)
    ratios = shift / np.where(known, sine2, 1.0)
    distance = np.abs(ratios - np.median(ratios[known]))
    return np.asarray(known & (distance <= RATIO_MADS * np.median(distance[known])))


def _shifts(R: Floats, t: Floats, m: Floats, n: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """``(n - R m) . l``, ``|l|^2``, l and R m, with l the part of t orthogonal to n. The first is |l|^2 / u."""
    a = m @ R.T
    along = t - (n @ t)[:, None] * n
    return np.einsum("ij,ij->i", n - a, along), np.einsum("ij,ij->i", along, along), along, a


def ratio_of(R: Floats, t: Floats, m: Floats, n: Floats, noise_rad: float) -> tuple[float, float]:
    """The weighted mean of |t| / depth and its standard deviation, in plain numpy.

    Shapes: ``R, t`` (3, 3), ``m, n`` (N, 3).
    """
    _, J = sampson_jacobian(R, t, m, n)
    typical = typical_ratios(R, t, m, n)
    if not typical.any():
        return float("nan"), inf
    shift, sine2, along, a = _shifts(R, t, m, n)
    weight = float(sine2[typical].sum())
    ratio = float(shift[typical].sum()) / weight
    # A rotation by w moves a by w x a. A change of t turns the line, which changes shift and sine2 to first order.
    by_rotation = -np.cross(a, along)[typical].sum(axis=0) / weight
    by_direction = (n - a - 2 * ratio * along)[typical].sum(axis=0) @ tangent_basis(t) / weight
    gradient = np.concatenate([by_rotation, by_direction])
    raw = J.T @ J
    return ratio, _ratio_sigma(gradient, raw, _information_of_noise(R, t, m, n, noise_rad), weight, noise_rad)


def _information_of_noise(R: Floats, t: Floats, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """The mean contribution of noise to J^T J (5, 5).

    The derivative by t is a x n, whose length is parallax plus noise. Without the subtraction of this contribution the
    direction of t would appear to be known where there is no parallax at all.
    """
    a = m @ R.T
    p, s = a @ t, n @ t
    weight = 1 / np.maximum(2 - p * p - s * s, 1e-12)
    B = tangent_basis(t)
    aB = a @ B
    added = np.zeros((5, 5))
    # The noise of two bearings, orthogonal to a, seen from the two directions in which t can move.
    added[3:, 3:] = 2 * noise_rad**2 * (weight.sum() * np.eye(2) - (aB * weight[:, None]).T @ aB)
    return added


def _ratio_sigma(gradient: Floats, raw: Floats, by_noise: Floats, weight: float, noise_rad: float) -> float:
    """Standard deviation of the ratio, from its derivatives by the motion and the information about the motion."""
    values, vectors = np.linalg.eigh(raw - by_noise)
    if values.min() <= 1e-12 * values.max():
        return inf
    image = (vectors / values) @ (vectors.T @ gradient)
    sigma = noise_rad * sqrt(float(image @ raw @ image) + 2 / weight)
    return sigma if isfinite(sigma) else inf
