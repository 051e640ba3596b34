"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, and the tests compare the two:

========================= =======================================================================================
:func:`residuals`         :meth:`quest.robust.pose_problem.RelativePoseProblem.residuals`
:func:`score`             :meth:`quest.robust.pose_problem.RelativePoseProblem.costs`
:func:`refine`            :func:`quest.geometry.refine.refine_pose`
:func:`refine_rotation`   :func:`quest.geometry.refine.refine_rotation`
:func:`newton_five`       the definition of its roots
========================= =======================================================================================

numba compiles a loop at its first call and keeps the machine code on disk. numba is imported in
:mod:`quest.robust.kernels.compiler` and nowhere else, and this package is imported where an estimation starts. The
loops use neither fast-math nor threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

from quest.robust.kernels.five_point import newton_five
from quest.robust.kernels.refinement import refine, refine_model, refine_rotation
from quest.robust.kernels.samples import try_samples
from quest.robust.kernels.scoring import residuals, residuals_of_model, score

__all__ = [
    "newton_five",
    "refine",
    "refine_model",
    "refine_rotation",
    "residuals",
    "residuals_of_model",
    "score",
    "try_samples",
]
