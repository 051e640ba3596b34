"""How much the direction of a translation hangs on single parts of the view.

A standard deviation from residuals knows the noise of single matches. It does not know that a tenth of them lie on a
body that moves by itself, slowly enough to be explained as well by a motion that is bent half way towards it: such a
motion has small residuals and is wrong. But it bends back where the body's part of the view is left out. So the motion
is fitted anew without each part, and the spread of these fits is the standard error that is right whatever the matches
of one part have in common (the delete-a-group jackknife [E82]_).

References
----------
.. [E82] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM 1982, chapter 3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.epipolar import as_matches
from quest.errors import InputError
from quest.neighbours import directions_of, regions_of
from quest.pose_problem import CompiledPoseProblem
from quest.relative_pose import RelativePose

__all__ = ["direction_spread_rad"]

Floats = NDArray[np.float64]

#: Parts of the view, across and down: as large as a body that can bend a motion without being told as an outlier. With
#: a dozen fits their spread is itself known to a fifth.
_PARTS = (4, 3)
#: Of the kernel, in deviations of the noise: that of the estimate itself.
_SCALE_SIGMAS = 3.0


def direction_spread_rad(pose: RelativePose, bearings1: ArrayLike, bearings2: ArrayLike) -> float:
    """Standard error of the direction of a translation along its worst axis, with matches that err alike in a part.

    The epipolar fit is asked, of a plane as well: the homography of a plane and a body on it is stable, and wrong.

    Parameters
    ----------
    pose : RelativePose
        Not of kind "rotation".
    bearings1, bearings2 : (N, 3) float
        The bearings that the pose was estimated from, of unit norm.

    Returns
    -------
    float
        Radians. Infinite where the inliers fill one part alone, or where too few are left without one.

    Raises
    ------
    InputError
        Where the pose is a rotation, or the bearings are not those it was estimated from.

    References
    ----------
    Module docstring.
    """
    m, n = as_matches(bearings1, bearings2, at_least=0)
    if pose.kind == "rotation":
        raise InputError("a rotation has no direction of translation: give a pose of kind 'general' or 'planar'")
    if m.shape != (len(pose.inliers), 3):
        raise InputError(f"bearings have shape {m.shape}: give the {len(pose.inliers)} matches of the pose")
    m, n = m[pose.inliers], n[pose.inliers]
    part = regions_of(directions_of(m), _PARTS)
    parts = np.unique(part)
    if len(parts) < 2 or np.bincount(part).max() > len(m) - 6:
        return float("inf")
    problem = CompiledPoseProblem(m, n, _SCALE_SIGMAS * pose.noise_rad)
    whole = problem.refine(np.concatenate([pose.q_wxyz, pose.t]), np.ones(len(m), bool), problem.threshold_rad)
    fits = np.array([problem.refine(whole, part != left_out, problem.threshold_rad)[4:] for left_out in parts])
    off = fits - fits.mean(axis=0)
    covariance = (len(parts) - 1) / len(parts) * off.T @ off
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
