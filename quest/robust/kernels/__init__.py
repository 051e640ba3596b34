"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, in the tests, which compare the two.

numba compiles a loop at its first call; :mod:`quest.machine_code` keeps the result. The loops use neither fast-math nor
threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

from quest.algebra import eigen_in_place, median_in_place, model_of_pose, models_of_poses, rotation_of_model, unit_rows
from quest.robust.kernels.local_optimization import climb, draw_subsets, refit
from quest.robust.kernels.noise import chance_inliers, mark_typical, typical_noise
from quest.robust.kernels.parallax import (
    anisotropy_sums,
    depths_and_parallax,
    pose_information,
    ratio_sums,
    rotation_of_all,
)
from quest.robust.kernels.planes import best_plane, fit_plane, off_line, planar_information
from quest.robust.kernels.quest_five import try_samples_of_five
from quest.robust.kernels.refinement import log_likelihood, refine, refine_rotation
from quest.robust.kernels.rotations import best_rotation
from quest.robust.kernels.samples import try_poses
from quest.robust.kernels.scoring import rays_by_row, residuals, residuals_of_model, score

__all__ = [
    "anisotropy_sums",
    "best_plane",
    "best_rotation",
    "chance_inliers",
    "climb",
    "depths_and_parallax",
    "draw_subsets",
    "eigen_in_place",
    "fit_plane",
    "log_likelihood",
    "mark_typical",
    "median_in_place",
    "model_of_pose",
    "models_of_poses",
    "off_line",
    "planar_information",
    "pose_information",
    "ratio_sums",
    "rays_by_row",
    "refine",
    "refine_rotation",
    "refit",
    "residuals",
    "residuals_of_model",
    "rotation_of_all",
    "rotation_of_model",
    "score",
    "try_poses",
    "try_samples_of_five",
    "typical_noise",
    "unit_rows",
]
