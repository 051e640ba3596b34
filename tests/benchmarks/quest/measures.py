"""The error of a pose, and summary measures of many errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import rotation_angle

Floats = NDArray[np.float64]


def pose_errors_deg(R: Floats, t: Floats, true_R: Floats, true_t: Floats) -> tuple[float, float]:
    """Angles in degrees between two rotations (3, 3), and between two translations (3,) of any norm.

    The sign of t is included: backward motion in place of forward motion is an error of 180 degrees. Where either
    translation is zero there is no direction, and the angle is infinite.
    """
    rotation = float(np.rad2deg(rotation_angle(R @ true_R.T)))
    if not (np.any(t) and np.any(true_t)):
        return rotation, float("inf")
    return rotation, float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(t, true_t)), t @ true_t)))


def accuracy(errors_deg: ArrayLike, bound_deg: float) -> float:
    """Share of errors below a bound; infinity and NaN are not below it. NaN where there are no errors."""
    errors = np.asarray(errors_deg, float)
    return float(np.mean(errors < bound_deg)) if errors.size else float("nan")


def area_under_recall(errors_deg: ArrayLike, bound_deg: float) -> float:
    """Area under the curve of recall over error from 0 to a bound, divided by the bound (AUC@bound).

    Recall at e is the share of errors of at most e, linear between the sorted errors and starting at (0, 0), as is
    usual in image matching (P.-E. Sarlin et al., "SuperGlue", CVPR 2020). Missing poses have infinite errors.
    """
    errors = np.sort(np.asarray(errors_deg, float))
    if not errors.size:
        return float("nan")
    errors = errors[errors < bound_deg]
    recall = np.arange(len(errors) + 1) / np.size(errors_deg)
    x = np.concatenate([[0.0], errors, [bound_deg]])
    y = np.concatenate([recall, recall[-1:]])
    return float(np.sum(np.diff(x) * (y[1:] + y[:-1])) / (2 * bound_deg))
