"""The noise of the bearings, and refinement of a motion with that noise in place of the caller's threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion
from quest.robust.pose_problem import CompiledPoseProblem, RelativePoseProblem
from quest.uncertainty.parallax import typical_ratios

__all__ = ["GATE_SIGMAS", "chance_inliers", "refine_with_noise", "settle"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
GATE_SIGMAS = 3.0


def refine_with_noise(problem: RelativePoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion with the noise that its residuals show.

    Parameters
    ----------
    problem : RelativePoseProblem
    model : (7,) float
        The motion (q_wxyz, t).

    Returns
    -------
    model : (7,) float
        The refined motion.
    noise_rad : float
        Standard deviation of a bearing, from the median absolute residual; at least a thousandth of the threshold.
    """
    noise_rad = problem.threshold_rad / GATE_SIGMAS
    before = np.zeros(len(problem), bool)
    for _ in range(3):
        r2, behind = problem.residuals(model[None])
        inlying = (r2[0] < problem.threshold_rad**2) & ~behind[0]
        inlying &= _has_typical_depth(problem, model, inlying)
        # Where at most one match in a thousand changes sides, the noise does not change either.
        if inlying.sum() < 6 or (inlying ^ before).sum() <= 1e-3 * inlying.sum():
            break
        before = inlying
        # 1.4826 times the median absolute deviation is the deviation of a Gaussian. The lower bound keeps the gates of
        # exact data open.
        noise_rad = max(1.4826 * float(np.sqrt(np.median(r2[0][inlying]))), 1e-3 * problem.threshold_rad)
        model = problem.refine(model, inlying, GATE_SIGMAS * noise_rad)
    return model, noise_rad


def _has_typical_depth(problem: RelativePoseProblem, model: Floats, inlying: Bools) -> Bools:
    """Whether the depth of a match (N,) is typical of the scene; False where the match is not inlying.

    An outlier that fits a motion by chance lies anywhere on its epipolar line. With little parallax the points of the
    scene lie within a few pixels of their lines.
    """
    typical = np.zeros(len(problem), bool)
    R, t = matrix_from_quaternion(model[:4]), model[4:]
    typical[inlying] = typical_ratios(R, t, problem.m[inlying], problem.n[inlying])
    return typical


def settle(problem: RelativePoseProblem, model: Floats, noise_rad: float) -> Floats:
    """Refine a motion twice on its inliers, with a known noise.

    Parameters
    ----------
    problem : RelativePoseProblem
    model : (7,) float
        The motion (q_wxyz, t).
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    (7,) float
        The motion as it came where fewer than six matches are inliers.
    """
    for _ in range(2):
        use = problem.explained(model, problem.threshold_rad)
        if use.sum() < 6:
            break
        model = problem.refine(model, use, GATE_SIGMAS * noise_rad)
    return model


def chance_inliers(problem: RelativePoseProblem, model: Floats, gate_rad: float, rng: np.random.Generator) -> float:
    """Mean number of matches that a motion explains after the matches are shuffled, over three shuffles.

    Parameters
    ----------
    problem : RelativePoseProblem
    model : (7,) float
        The motion (q_wxyz, t).
    gate_rad : float
        Sampson error above which a match is not explained.
    rng : numpy.random.Generator

    Returns
    -------
    float
    """
    counts = []
    for _ in range(3):
        shuffled = CompiledPoseProblem(problem.m, problem.n[rng.permutation(len(problem))], problem.threshold_rad)
        counts.append(int(shuffled.explained(model, gate_rad).sum()))
    return float(np.mean(counts))
