"""The noise of the bearings, and refinement of a motion with that noise in place of the caller's threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion
from quest.robust.pose_problem import RelativePoseProblem
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS, typical_ratios

__all__ = [
    "GATE_SIGMAS",
    "chance_inliers",
    "refine_with_noise",
    "refine_with_noise_compiled",
    "settle",
    "settle_compiled",
]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
GATE_SIGMAS = 3.0
#: Number of shuffled matches, for an error of a fifth where one in 40 is explained by chance; the least number of
#: shuffles; and the largest number of shuffled matches, for an error of an eighth.
_SHUFFLED_MATCHES, _LEAST_SHUFFLES, _MOST_SHUFFLED = 1000, 3, 3000
#: Number of unknowns of a motion.
_UNKNOWNS = 5
#: Largest number of steps of a refinement.
_STEPS = 12


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
        # 1.4826 times the median absolute deviation is the deviation of a Gaussian. The lower bound keeps the gates of
        # exact data open.
        few = _few_matches(int(inlying.sum()))
        noise_rad = max(1.4826 * few * float(np.sqrt(np.median(r2[0][inlying]))), 1e-3 * problem.threshold_rad)
        model = problem.refine(model, inlying, GATE_SIGMAS * noise_rad)
    return model, noise_rad


def refine_with_noise_compiled(problem: RelativePoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion as :func:`refine_with_noise`, compiled.

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
        Standard deviation of a bearing.
    """
    from quest.robust import kernels

    m, n, threshold_rad = problem.m, problem.n, problem.threshold_rad
    R, t = kernels.rotation_of_model(model), model[4:].copy()
    noise_rad, use = threshold_rad / GATE_SIGMAS, np.zeros(len(problem), bool)
    for _ in range(3):
        count, changed, median_rad = kernels.typical_inliers(m, n, R, t, threshold_rad, RATIO_MADS, LEAST_SINE2, use)
        if count < 6 or changed <= 1e-3 * count:
            break
        noise_rad = max(1.4826 * _few_matches(count) * median_rad, 1e-3 * threshold_rad)
        kernels.refine(m, n, use, R, t, GATE_SIGMAS * noise_rad, _STEPS)
    return kernels.model_of_pose(R, t), noise_rad


def _few_matches(count: int) -> float:
    """The factor of Rousseeuw and Leroy for small samples: the motion has adapted to few matches."""
    return 1 + _UNKNOWNS / max(count - _UNKNOWNS, 1)


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


def settle_compiled(problem: RelativePoseProblem, model: Floats, noise_rad: float, raw: bool) -> Floats:
    """Refine a motion as :func:`settle`, compiled.

    Parameters
    ----------
    problem : RelativePoseProblem
    model : (7,) float
        The motion (q_wxyz, t).
    noise_rad : float
        Standard deviation of a bearing.
    raw : bool
        Whether the motion comes from a sample: it is polished before.

    Returns
    -------
    (7,) float
    """
    from quest.robust import kernels

    R, t, threshold_rad = kernels.rotation_of_model(model), model[4:].copy(), problem.threshold_rad
    stages = [(threshold_rad, GATE_SIGMAS * noise_rad)] * 2
    if raw:
        stages = [(2 * threshold_rad, 0.5 * threshold_rad), *stages]
    kernels.climb(problem.m, problem.n, R, t, threshold_rad, np.array(stages), len(problem), _STEPS)
    return kernels.model_of_pose(R, t)


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
        The mean over at least one shuffle, and over three where there are at most 1000 matches. Half a match counts
        where none is explained: a mean of zero would say that chance explains nothing.
    """
    from quest.robust import kernels

    total = len(problem)
    trials = max(_LEAST_SHUFFLES, -(-_SHUFFLED_MATCHES // total)) * total
    trials = max(total, min(trials, _MOST_SHUFFLED))
    order = rng.permutation(total)
    explained = kernels.chance_inliers(
        problem.m[order], problem.n[order], model, problem.threshold_rad, gate_rad, trials
    )
    return max(explained, 0.5) * total / trials
