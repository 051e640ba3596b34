"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, and the tests compare the two:

=========================== =====================================================================================
:func:`residuals`           :meth:`quest.robust.pose_problem.RelativePoseProblem.residuals`
:func:`score`               :meth:`quest.robust.pose_problem.RelativePoseProblem.costs`
:func:`refine`              :func:`quest.geometry.refine.refine_pose`
:func:`refine_rotation`     :func:`quest.geometry.refine.refine_rotation`
:func:`newton_five`         the definition of its roots
:func:`climb`               :meth:`quest.robust.pose_problem.RelativePoseProblem.polish`, :func:`quest.noise.settle`
:func:`mark_typical`        :func:`quest.uncertainty.parallax.typical_ratios`
:func:`anisotropy_sums`     :func:`quest.uncertainty.parallax.anisotropy_of`
:func:`ratio_sums`          :func:`quest.uncertainty.parallax.ratio_of`
:func:`pose_information`    :func:`quest.geometry.refine.sampson_jacobian`
:func:`depths_and_parallax` :func:`quest.geometry.epipolar.depths_along_epipolar_lines`
:func:`planar_information`  :func:`quest.covariance.planar_pose_covariance`
:func:`fit_plane`           :func:`quest.robust.plane.fit_plane`
:func:`off_line`            :func:`quest.robust.plane.off_line_rad`
=========================== =====================================================================================

numba compiles a loop at its first call; :mod:`quest.robust.kernels.machine_code` keeps the result. numba is imported in
:mod:`quest.robust.kernels.compiler` and nowhere else, and this package is imported where an estimation starts. The
loops use neither fast-math nor threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

from quest.robust.kernels.five_point import newton_five
from quest.robust.kernels.local_optimization import climb, draw_starts, refit
from quest.robust.kernels.noise import chance_inliers, mark_typical, typical_inliers
from quest.robust.kernels.parallax import (
    anisotropy_sums,
    depths_and_parallax,
    pose_information,
    ratio_sums,
    rotation_of_all,
)
from quest.robust.kernels.planes import best_plane, fit_plane, off_line, planar_information
from quest.robust.kernels.refinement import refine, refine_rotation
from quest.robust.kernels.rotations import best_rotation
from quest.robust.kernels.samples import try_samples
from quest.robust.kernels.scoring import residuals, residuals_of_model, score
from quest.robust.kernels.small_algebra import eigen_in_place, model_of_pose, rotation_of_model, unit_rows

__all__ = [
    "anisotropy_sums",
    "best_plane",
    "best_rotation",
    "chance_inliers",
    "climb",
    "depths_and_parallax",
    "draw_starts",
    "eigen_in_place",
    "fit_plane",
    "mark_typical",
    "model_of_pose",
    "newton_five",
    "off_line",
    "planar_information",
    "pose_information",
    "ratio_sums",
    "refine",
    "refine_rotation",
    "refit",
    "residuals",
    "residuals_of_model",
    "rotation_of_all",
    "rotation_of_model",
    "score",
    "try_samples",
    "typical_inliers",
    "unit_rows",
]
