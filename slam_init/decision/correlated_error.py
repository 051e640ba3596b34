"""Errors that neighbouring tracks share, measured by how much alike the residuals of neighbours are.

What averages out among tracks is no danger to a baseline's direction; what neighbours share is: drift of the tracker,
what a lens calibration leaves, a rolling shutter, blur. A motion fitted to such a field takes in a part of it, and
leaves the rest in the residuals, where neighbours then agree. The products of the residuals of two tracks of one region
of the view have the variance of the shared error as their mean, whatever the noise of single tracks is.

On filmed sequences with a good ground truth the directions were off by what this says: in half of the pairs by less, in
one of ten by more than twice as much. A field that is smooth over the whole view and in one of the views only (another
focus) is taken in by the motion nearly as a whole, and is not measured.
"""

from __future__ import annotations

import numpy as np

from quest.geometry.refine import sampson_jacobian
from quest.relative_pose import RelativePose
from quest.robust.spatial_blocks import regions_of
from slam_init.types.arrays import Floats

__all__ = ["rounding_error_px", "shared_error_rad"]

#: Of coordinates with a fraction hardly any is a whole number.
_WHOLE = 0.1
#: More than an inlier's residual cannot be shared.
_GATE_SIGMAS = 3.0


def rounding_error_px(pixels: Floats) -> float:
    """Standard deviation of the rounding of pixels (N, 2) that are whole numbers; 0 where they are not.

    Tracks that move alike are rounded alike, so that their residuals do not show it: with ORB's corners, whole in the
    first octave, many tracks follow a wrong motion exactly.
    """
    whole = float(np.mean(pixels == np.round(pixels))) if len(pixels) else 0.0
    return float(1 / np.sqrt(12)) if whole > _WHOLE else 0.0


def shared_error_rad(pose: RelativePose, m: Floats, n: Floats, where: Floats) -> float:
    """The error that neighbours share, of a motion's inliers, in radians: measured, and what may be hidden.

    Parameters
    ----------
    pose : RelativePose
        Not of kind "rotation".
    m, n : (N, 3) float
        Unit bearings of the matches that the pose was estimated from.
    where : (N, 2) float
        Where the tracks were seen in the first view.
    """
    inliers = pose.inliers
    residuals, _ = sampson_jacobian(pose.R, pose.t, m[inliers], n[inliers])
    most = _GATE_SIGMAS * pose.noise_rad
    region = regions_of(where[inliers])
    count = np.bincount(region)
    pairs = float(np.sum(count * (count - 1.0)))
    if pairs == 0:  # no two tracks are neighbours
        return most
    squares = np.bincount(region, weights=residuals**2)
    products = float(np.sum(np.bincount(region, weights=residuals) ** 2 - squares))
    # Of independent residuals: each pair is counted twice and has the squared variance.
    deviation = float(np.mean(residuals**2)) * np.sqrt(2 * pairs) / pairs
    # What is not seen may still be there.
    return float(min(np.sqrt(max(products / pairs, 0.0) + deviation), most))
