"""How much the direction of a translation depends on single parts of the view.

A standard deviation from residuals accounts for the noise of single matches. It does not account for a common error:
where a tenth of the matches lie on a slow moving body, a motion between that of the camera and that of the body
explains all matches. Its residuals are small, and it is wrong. But the fit changes where the body's part of the view is
left out. So the motion is fitted again without each part. The spread of these fits is the standard error, whatever
error the matches of one part have in common (the delete-a-group jackknife [E82]_, with weights for parts of unequal
size [B99]_).

References
----------
.. [E82] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM 1982, chapter 3.
.. [B99] F. Busing, E. Meijer, R. van der Leeden, "Delete-m jackknife for unequal m", Statistics and Computing 1999.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches
from quest.geometry.refine import sampson_jacobian
from quest.relative_pose import RelativePose
from quest.robust.pose_problem import CompiledPoseProblem
from quest.robust.spatial_blocks import directions_of, regions_of

__all__ = ["direction_spread_rad"]

Floats = NDArray[np.float64]

#: Parts of the view that the inliers fill, across and down. A part is as large as a body that can change a motion
#: without becoming an outlier. The spread of a dozen fits is known to a fifth.
_PARTS = (4, 3)
#: A fit is an independent estimate if it has six matches and some more, and a hundredth of the information of all
#: matches. With less information the fit stays at its start, and the spread is too small.
_LEAST_LEFT, _LEAST_INFORMATION = 10, 0.01
#: Scale of the robust kernel in standard deviations of the noise, as in the estimate itself.
_SCALE_SIGMAS = 3.0


def direction_spread_rad(pose: RelativePose, bearings1: ArrayLike, bearings2: ArrayLike) -> float:
    """Standard error of the direction of a translation along its worst axis, with correlated errors inside each part.

    The fits minimize epipolar residuals, for a plane too: the homography of a plane with a body on it is stable, and
    wrong.

    Parameters
    ----------
    pose : RelativePose
        An estimate of kind "general" or "planar".
    bearings1, bearings2 : (N, 3) array_like
        The bearings that the pose was estimated from.

    Returns
    -------
    float
        Radians. Infinite where the matches outside of one of the parts do not determine the motion.

    Raises
    ------
    InputError
        If the pose is a rotation, or the number of bearings is not that of the estimate.

    References
    ----------
    See the module docstring. Departure from [B99]_: the spread is taken around the fit to all matches and not around
    the mean of the jackknife, so that a bias (the mean change when a part is left out) counts as error too.
    """
    m, n = as_matches(bearings1, bearings2, at_least=0)
    if pose.kind == "rotation":
        raise InputError("a rotation has no direction of translation: give a pose of kind 'general' or 'planar'")
    if m.shape != (len(pose.inliers), 3):
        raise InputError(f"bearings have shape {m.shape}: give the {len(pose.inliers)} matches of the pose")
    m, n = m[pose.inliers], n[pose.inliers]
    part = regions_of(directions_of(m), _PARTS)
    parts, count = np.unique(part, return_counts=True)
    if len(parts) < 2 or len(m) - count.max() < _LEAST_LEFT:
        return float("inf")
    _, J = sampson_jacobian(pose.R, pose.t, m, n)
    information = J.T @ J
    if not np.trace(information) > 0:
        return float("inf")
    left = np.array([information - J[part == one].T @ J[part == one] for one in parts])
    # In units of the information of all matches, so that the units of the five unknowns do not matter.
    whiten = np.linalg.inv(np.linalg.cholesky(information + 1e-12 * np.trace(information) * np.eye(5)))
    if np.linalg.eigvalsh(whiten @ left @ whiten.T).min() < _LEAST_INFORMATION:
        return float("inf")
    problem = CompiledPoseProblem(m, n, _SCALE_SIGMAS * pose.noise_rad)
    whole = problem.refine(np.concatenate([pose.q_wxyz, pose.t]), np.ones(len(m), bool), problem.threshold_rad)
    fits = np.array([problem.refine(whole, part != left_out, problem.threshold_rad)[4:] for left_out in parts])
    weight = (len(m) / count - 1) / len(parts)
    off = fits - whole[4:]
    return float(np.sqrt(max(np.linalg.eigvalsh((off * weight[:, None]).T @ off)[-1], 0.0)))
