"""The noise of the bearings, and refinement of a motion with that noise in place of the caller's threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.pose_problem import PoseProblem
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
GATE_SIGMAS = 3.0
#: Scale of the kernel of Geman and McClure in the last refinement, in standard deviations of the noise. For Gaussian
#: noise 3 has 0.91 of the efficiency of least squares, 2.5 has 0.86, 2 has 0.78. On 418 real pairs (2 px) the AUC at
#: 5 / 10 / 20 degrees is 61.8 / 71.0 / 77.4 with 3, and 62.4 / 71.6 / 77.9 with 2.5. But with 2.5 the pipeline waits
#: for 32 frames instead of 8 in a simulated hospital. With the threshold as the scale the AUC is 60.2 / 70.1 / 76.8.
KERNEL_SIGMAS = 3.0
#: Number of unknowns of a motion.
_UNKNOWNS = 5
#: Largest number of steps of a refinement.
_STEPS = 12


def refine_with_noise(problem: PoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion (q_wxyz, t) with the noise that its residuals show; return the motion and that noise.

    The noise is the standard deviation of a bearing, from the median absolute residual; at least a thousandth of the
    threshold. Matches of untypical depth do not take part: an outlier that fits a motion by chance lies anywhere on its
    epipolar line, while with little parallax the points of the scene lie within a few pixels of their lines.

    P. J. Rousseeuw and A. M. Leroy, "Robust Regression and Outlier Detection", 1987, section 5.1: the factor for small
    samples.
    """
    from quest.robust import kernels

    m, n, threshold_rad = problem.m, problem.n, problem.threshold_rad
    R, t = kernels.rotation_of_model(model), model[4:].copy()
    noise_rad, use = threshold_rad / GATE_SIGMAS, np.zeros(len(problem), bool)
    for _ in range(3):
        count, changed, median_rad = kernels.typical_inliers(m, n, R, t, threshold_rad, RATIO_MADS, LEAST_SINE2, use)
        # Where at most one match in a thousand changes sides, the noise does not change either.
        if count < 6 or changed <= 1e-3 * count:
            break
        # 1.4826 times the median absolute deviation is the deviation of a Gaussian. The lower bound keeps the gates of
        # exact data open.
        noise_rad = max(1.4826 * _few_matches(count) * median_rad, 1e-3 * threshold_rad)
        kernels.refine(m, n, use, R, t, KERNEL_SIGMAS * noise_rad, _STEPS)
    return kernels.model_of_pose(R, t), noise_rad


def _few_matches(count: int) -> float:
    """The factor of Rousseeuw and Leroy for small samples: the motion has adapted to few matches."""
    return 1 + _UNKNOWNS / max(count - _UNKNOWNS, 1)


def settle(problem: PoseProblem, model: Floats, noise_rad: float, raw: bool) -> Floats:
    """Refine a motion (q_wxyz, t) twice on its inliers, with a known noise; a raw one of a sample is polished before.

    The motion stays as it is where fewer than six matches are inliers.
    """
    from quest.robust import kernels

    R, t, threshold_rad = kernels.rotation_of_model(model), model[4:].copy(), problem.threshold_rad
    stages = [(threshold_rad, KERNEL_SIGMAS * noise_rad)] * 2
    if raw:
        stages = [(2 * threshold_rad, 0.5 * threshold_rad), *stages]
    kernels.climb(problem.m, problem.n, R, t, threshold_rad, np.array(stages), len(problem), _STEPS)
    return kernels.model_of_pose(R, t)
