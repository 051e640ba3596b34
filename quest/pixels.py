"""Relative pose from pixels: the entrance for pinhole cameras with known K, with or without distortion.

The other modules of the package take bearings. This module turns pixels into bearings with the inverse of the camera
and the threshold in pixels into an angle, and calls :func:`quest.estimate_relative_pose`. For a fisheye camera give
bearings to :func:`quest.estimate_relative_pose`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats, as_pixels, as_positive
from quest.estimate import estimate_relative_pose
from quest.relative_pose import NoPose, RelativePose

Floats = NDArray[np.float64]

#: Steps that take distorted coordinates to undistorted ones, and the largest error that is left, in focal lengths.
_STEPS, _LARGEST_ERROR = 50, 1e-7


def estimate_relative_pose_px(
    points1: ArrayLike,
    points2: ArrayLike,
    K1: ArrayLike,
    K2: ArrayLike | None = None,
    *,
    distortion1: ArrayLike | None = None,
    distortion2: ArrayLike | None = None,
    threshold_px: float = 1.0,
    seed: int = 0,
    confidence: float = 0.999,
    max_samples: int = 50_000,
    scores: ArrayLike | None = None,
) -> RelativePose | NoPose:
    """Estimate the motion between two pinhole views from matched pixels with outliers.

    Parameters
    ----------
    points1, points2 : (N, 2) array_like
        Matched pixels (x, y) in image 1 and image 2.
    K1, K2 : (3, 3) array_like
        Camera matrices ``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`` in pixels. Without K2 both views have K1.
    distortion1, distortion2 : (4,) or (5,) array_like, optional
        Distortion k1, k2, p1, p2, k3 of each camera, as OpenCV has it; by default none. Without K2, distortion1 is that
        of both views.
    threshold_px : float
        A match whose Sampson error is larger is an outlier: about three times the standard deviation of a pixel
        coordinate. The angle for :func:`quest.estimate_relative_pose` is ``threshold_px`` divided by the mean focal
        length of the two cameras, ``(fx1 + fy1 + fx2 + fy2) / 4``.
    seed : int
        Seed of the random samples.
    confidence : float
        Probability with which RANSAC finds the best motion.
    max_samples : int
        Bound on the number of samples.
    scores : (N,) array_like, optional
        Quality of the matches, higher is better.

    Returns
    -------
    RelativePose or NoPose
        As of :func:`quest.estimate_relative_pose`: angles are radians, depths are distances along the rays.

    Raises
    ------
    InputError
        If the points are not two finite arrays (N, 2) of one shape, K1 or K2 is no camera matrix (not finite, not
        (3, 3), a focal length that is not positive, a last row other than 0 0 1, a second row that does not begin with
        0), a distortion has not four or five finite numbers or takes a pixel out of the lens, threshold_px is not
        positive, or another argument is refused by :func:`quest.estimate_relative_pose`.
    """
    K1 = _camera_matrix(K1, "K1")
    if K2 is None and distortion2 is None:
        distortion2 = distortion1
    K2 = K1 if K2 is None else _camera_matrix(K2, "K2")
    points1, points2 = as_pixels(points1, points2)
    threshold_px = as_positive(threshold_px, "threshold_px", "a positive number of pixels")
    focal_px = float(K1[0, 0] + K1[1, 1] + K2[0, 0] + K2[1, 1]) / 4
    return estimate_relative_pose(
        _bearings(points1, K1, distortion1),
        _bearings(points2, K2, distortion2),
        threshold_rad=threshold_px / focal_px,
        seed=seed,
        confidence=confidence,
        max_samples=max_samples,
        scores=scores,
    )


def _camera_matrix(K: ArrayLike, name: str) -> Floats:
    K = as_floats(K, name)
    if K.shape != (3, 3) or not np.isfinite(K).all():
        raise InputError(f"{name} has shape {K.shape}: give a finite camera matrix (3, 3)")
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise InputError(f"{name} has the focal lengths {K[0, 0]:g} and {K[1, 1]:g}: give positive ones, in pixels")
    if K[1, 0] != 0 or K[2].tolist() != [0, 0, 1]:
        raise InputError(f"{name} is no camera matrix: give [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]")
    return K


def _bearings(points: Floats, K: Floats, distortion: ArrayLike | None) -> Floats:
    """Rays (N, 3) with z = 1 of pixels (N, 2)."""
    y = (points[:, 1] - K[1, 2]) / K[1, 1]
    x = (points[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    places = np.column_stack([x, y])
    if distortion is not None:
        places = _undistorted(places, _coefficients(distortion))
    return np.column_stack([places, np.ones(len(points))])


def _coefficients(distortion: ArrayLike) -> Floats:
    given = as_floats(distortion, "the distortion").ravel()
    if len(given) not in (4, 5) or not np.isfinite(given).all():
        raise InputError(f"the distortion has {len(given)} numbers: give finite k1, k2, p1, p2 and perhaps k3")
    return np.append(given, 0.0)[:5]


def _undistorted(places: Floats, coefficients: Floats) -> Floats:
    """Invert the model of Brown and Conrady by iteration: ``x <- (x_d - tangential(x)) / radial(x)``."""
    x = places.copy()
    for _ in range(_STEPS):
        radial, tangential = _distortion_of(x, coefficients)
        x = (places - tangential) / radial
    radial, tangential = _distortion_of(x, coefficients)
    if not (np.abs(x * radial + tangential - places) < _LARGEST_ERROR).all():
        raise InputError("a pixel lies outside the distortion of its camera: remove it, or give bearings")
    return x


def _distortion_of(x: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """The radial factor (N, 1), and the tangential shift (N, 2), of undistorted places (N, 2)."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = np.sum(x * x, axis=1, keepdims=True)
    product = 2 * x[:, :1] * x[:, 1:]
    shift = np.concatenate(
        [p1 * product + p2 * (r2 + 2 * x[:, :1] ** 2), p1 * (r2 + 2 * x[:, 1:] ** 2) + p2 * product], 1
    )
    return 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), shift
