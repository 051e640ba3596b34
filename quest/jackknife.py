"""How much the direction of a translation hangs on single parts of the view.

A standard deviation from residuals knows the noise of single matches. It does not know that a tenth of them lie on a
body that moves by itself, slowly enough to be explained as well by a motion that is bent half way towards it: such a
motion has small residuals and is wrong. But it bends back where the body's part of the view is left out. So the motion
is fitted anew without each part, and the spread of these fits is the standard error that is right whatever the matches
of one part have in common (the delete-a-group jackknife [E82]_, with weights for parts of unequal size [B99]_).

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

#: Parts of what the inliers fill, across and down: as large as a body that can bend a motion without being told as an
#: outlier. With a dozen fits their spread is itself known to a fifth.
_PARTS = (4, 3)
#: A fit needs six matches, and some to spare, to be a second opinion; and a hundredth of the information of all: with
#: less it stays where it started, and its spread says nothing.
_LEAST_LEFT, _LEAST_INFORMATION = 10, 0.01
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
        Radians. Infinite where what is left without one of the parts says nothing of the motion.

    Raises
    ------
    InputError
        Where the pose is a rotation, or the bearings are not as many as it was estimated from.

    References
    ----------
    Module docstring. Departing from [B99]_ the spread is taken around the fit to all matches and not around the
    jackknife's own mean: what leaving out a part changes on average, a bias, counts as error too.
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
    # In units of the information of all, whatever the units of the five unknowns are.
    whiten = np.linalg.inv(np.linalg.cholesky(information + 1e-12 * np.trace(information) * np.eye(5)))
    if np.linalg.eigvalsh(whiten @ left @ whiten.T).min() < _LEAST_INFORMATION:
        return float("inf")
    problem = CompiledPoseProblem(m, n, _SCALE_SIGMAS * pose.noise_rad)
    whole = problem.refine(np.concatenate([pose.q_wxyz, pose.t]), np.ones(len(m), bool), problem.threshold_rad)
    fits = np.array([problem.refine(whole, part != left_out, problem.threshold_rad)[4:] for left_out in parts])
    weight = (len(m) / count - 1) / len(parts)
    off = fits - whole[4:]
    return float(np.sqrt(max(np.linalg.eigvalsh((off * weight[:, None]).T @ off)[-1], 0.0)))
