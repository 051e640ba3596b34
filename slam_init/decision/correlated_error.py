"""Correlated tracking errors: errors that neighbouring tracks have in common, measured from their residuals.

Independent errors average out over the tracks and hardly change the direction of the baseline. Errors that neighbouring
tracks have in common do not average out. Their causes are drift of the tracker, the remaining error of the lens
calibration, a rolling shutter, and blur. A motion that is fitted to such a field of errors absorbs a part of it. The
rest stays in the residuals, which then agree between neighbours. The mean product of the residuals of two tracks in one
region of the image is the variance of the correlated error, whatever the noise of single tracks is.

On filmed sequences with sound ground truth, the error of the direction was below this measure in half of the pairs, and
above twice the measure in one pair of ten. The measure is a lower bound for one kind of error: a field that is smooth
over the whole image and present in one view only, as after a change of focus. The motion absorbs nearly all of it.
"""

from __future__ import annotations

import numpy as np

from quest.geometry.refine import sampson_jacobian
from quest.relative_pose import RelativePose
from quest.robust.spatial_blocks import regions_of
from slam_init.types.arrays import Floats

__all__ = ["correlated_error_rad", "rounding_error_px"]

#: Coordinates with fractions are hardly ever whole numbers; up to a tenth of them may be whole by chance.
_WHOLE_SHARE = 0.1
#: The correlated error of inliers cannot exceed their largest residual, three standard deviations.
_GATE_SIGMAS = 3.0


def rounding_error_px(pixels: Floats) -> float:
    """Return the standard deviation of the rounding of pixels that are whole numbers.

    Tracks with equal displacements have equal rounding errors, so that their residuals do not show the rounding. The
    corners of ORB are whole pixels in the first octave, and many of these tracks agree exactly with a wrong motion.

    Parameters
    ----------
    pixels : (N, 2) float

    Returns
    -------
    float
        In pixels; 0 where the coordinates have fractions.
    """
    whole = float(np.mean(pixels == np.round(pixels))) if len(pixels) else 0.0
    return float(1 / np.sqrt(12)) if whole > _WHOLE_SHARE else 0.0


def correlated_error_rad(pose: RelativePose, rays1: Floats, rays2: Floats, where: Floats) -> float:
    """Estimate the correlated tracking error of the inliers of a motion from above.

    Parameters
    ----------
    pose : RelativePose
        Not of kind "rotation".
    rays1, rays2 : (N, 3) float
        Unit bearings of the matches that the pose was estimated from.
    where : (N, 2) float
        Coordinates of the tracks in the first view.

    Returns
    -------
    float
        Radians of a bearing: the measured value plus one standard deviation of the measurement, and at most three
        standard deviations of the noise.
    """
    inliers = pose.inliers
    residuals, _ = sampson_jacobian(pose.R, pose.t, rays1[inliers], rays2[inliers])
    most = _GATE_SIGMAS * pose.noise_rad
    region = regions_of(where[inliers])
    count = np.bincount(region)
    pairs = float(np.sum(count * (count - 1.0)))
    if pairs == 0:  # no two tracks are neighbours
        return most
    squares = np.bincount(region, weights=residuals**2)
    products = float(np.sum(np.bincount(region, weights=residuals) ** 2 - squares))
    # Standard deviation of the mean product of independent residuals: each pair is counted twice, and each product has
    # the squared variance of a residual.
    deviation = float(np.mean(residuals**2)) * np.sqrt(2 * pairs) / pairs
    # The deviation is added, since a smaller correlated error would not be noticed.
    return float(min(np.sqrt(max(products / pairs, 0.0) + deviation), most))
