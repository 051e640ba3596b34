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
#: Number of shuffled matches, for an error of a fifth where one in 40 is explained by chance, and the least number of
#: shuffles.
_SHUFFLED_MATCHES, _LEAST_SHUFFLES = 1000, 3
#: Number of unknowns of a motion.
_UNKNOWNS = 5


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

    References
    ----------
    P. J. Rousseeuw and A. M. Leroy, "Robust Regression and Outlier Detection", 1987, section 5.1: the factor for small
    samples.
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
        # 1.4826 times the median absolute deviation is the deviation of a Gaussian. The motion has adapted to few
        # matches, hence the factor of Rousseeuw and Leroy for small samples. The lower bound keeps the gates of exact
        # data open.
        few = 1 + _UNKNOWNS / max(int(inlying.sum()) - _UNKNOWNS, 1)
        noise_rad = max(1.4826 * few * float(np.sqrt(np.median(r2[0][inlying]))), 1e-3 * problem.threshold_rad)
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
    """Mean number of matches that a motion explains after the matches are shuffled.

    This is what a wrong motion reaches on these very matches, so that a small share of inliers can be enough, and a
    large one too little. In a shuffle no match keeps its partner: one that did would be no random match.

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
        The mean over at least three shuffles. Half a match counts where none is explained: a mean of zero would say
        that chance explains nothing.
    """
    total = len(problem)
    shuffles = max(_LEAST_SHUFFLES, -(-_SHUFFLED_MATCHES // total))
    explained = 0
    for _ in range(shuffles):
        order = rng.permutation(total)
        m, n = problem.m[order], problem.n[np.roll(order, 1)]
        explained += int(CompiledPoseProblem(m, n, problem.threshold_rad).explained(model, gate_rad).sum())
    return max(explained, 0.5) / shuffles
