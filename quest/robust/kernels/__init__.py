"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, in :mod:`quest.geometry.refine` or in
``tests/support/reference_*.py``, and the tests compare the two.

numba compiles a loop at its first call; :mod:`quest.robust.kernels.machine_code` keeps the result. numba is imported in
:mod:`quest.robust.kernels.compiler` and nowhere else, when the first loop is used. The loops use neither fast-math nor
threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from quest.robust.kernels.five_point import newton_five
    from quest.robust.kernels.local_optimization import climb, draw_starts, refit
    from quest.robust.kernels.mixture import log_likelihood, refine_with_noise
    from quest.robust.kernels.noise import chance_inliers, mark_typical
    from quest.robust.kernels.parallax import (
        anisotropy_sums,
        depths_and_parallax,
        pose_information,
        ratio_sums,
        rotation_of_all,
    )
    from quest.robust.kernels.planes import best_plane, fit_plane, off_line, planar_information
    from quest.robust.kernels.quest_five import try_samples_of_five
    from quest.robust.kernels.refinement import refine, refine_rotation
    from quest.robust.kernels.rotations import best_rotation
    from quest.robust.kernels.samples import try_samples
    from quest.robust.kernels.scoring import rays_by_row, residuals, residuals_of_model, score
    from quest.robust.kernels.six_point import try_samples_of_six
    from quest.robust.kernels.small_algebra import (
        eigen_in_place,
        median_in_place,
        model_of_pose,
        models_of_poses,
        rotation_of_model,
        unit_rows,
    )

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
    "log_likelihood",
    "mark_typical",
    "median_in_place",
    "model_of_pose",
    "models_of_poses",
    "newton_five",
    "off_line",
    "planar_information",
    "pose_information",
    "ratio_sums",
    "rays_by_row",
    "refine",
    "refine_rotation",
    "refine_with_noise",
    "refit",
    "residuals",
    "residuals_of_model",
    "rotation_of_all",
    "rotation_of_model",
    "score",
    "try_samples",
    "try_samples_of_five",
    "try_samples_of_six",
    "unit_rows",
]

#: The loops by module. A module is loaded, and numba with it, when one of its loops is first used.
_LOOPS = {
    "five_point": "newton_five",
    "local_optimization": "climb draw_starts refit",
    "mixture": "log_likelihood refine_with_noise",
    "noise": "chance_inliers mark_typical",
    "parallax": "anisotropy_sums depths_and_parallax pose_information ratio_sums rotation_of_all",
    "planes": "best_plane fit_plane off_line planar_information",
    "quest_five": "try_samples_of_five",
    "refinement": "refine refine_rotation",
    "rotations": "best_rotation",
    "samples": "try_samples",
    "scoring": "rays_by_row residuals residuals_of_model score",
    "six_point": "try_samples_of_six",
    "small_algebra": "eigen_in_place median_in_place model_of_pose models_of_poses rotation_of_model unit_rows",
}
_MODULE_OF = {loop: module for module, loops in _LOOPS.items() for loop in loops.split()}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    loop = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = loop  # so that the next call finds it at once
    return loop
