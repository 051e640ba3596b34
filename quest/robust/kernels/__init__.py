"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, in the tests, which compare the two.

numba compiles a loop at its first call; :mod:`quest.machine_code` keeps the result. A module is loaded, and numba
with it, when one of its loops is first used. The loops use neither fast-math nor
threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from quest.algebra import eigen_in_place as eigen_in_place
    from quest.algebra import median_in_place as median_in_place
    from quest.algebra import model_of_pose as model_of_pose
    from quest.algebra import models_of_poses as models_of_poses
    from quest.algebra import rotation_of_model as rotation_of_model
    from quest.algebra import unit_rows as unit_rows
    from quest.robust.kernels.local_optimization import climb as climb
    from quest.robust.kernels.local_optimization import draw_subsets as draw_subsets
    from quest.robust.kernels.local_optimization import refit as refit
    from quest.robust.kernels.noise import chance_inliers as chance_inliers
    from quest.robust.kernels.noise import mark_typical as mark_typical
    from quest.robust.kernels.noise import typical_noise as typical_noise
    from quest.robust.kernels.parallax import anisotropy_sums as anisotropy_sums
    from quest.robust.kernels.parallax import depths_and_parallax as depths_and_parallax
    from quest.robust.kernels.parallax import pose_information as pose_information
    from quest.robust.kernels.parallax import ratio_sums as ratio_sums
    from quest.robust.kernels.parallax import rotation_of_all as rotation_of_all
    from quest.robust.kernels.planes import best_plane as best_plane
    from quest.robust.kernels.planes import fit_plane as fit_plane
    from quest.robust.kernels.planes import off_line as off_line
    from quest.robust.kernels.planes import planar_information as planar_information
    from quest.robust.kernels.quest_five import try_samples_of_five as try_samples_of_five
    from quest.robust.kernels.refinement import refine as refine
    from quest.robust.kernels.refinement import refine_rotation as refine_rotation
    from quest.robust.kernels.rotations import best_rotation as best_rotation
    from quest.robust.kernels.samples import try_poses as try_poses
    from quest.robust.kernels.scoring import rays_by_row as rays_by_row
    from quest.robust.kernels.scoring import residuals as residuals
    from quest.robust.kernels.scoring import residuals_of_model as residuals_of_model

#: The loops by module.
_LOOPS = {
    "quest.algebra": "eigen_in_place median_in_place model_of_pose models_of_poses rotation_of_model unit_rows",
    "quest.robust.kernels.local_optimization": "climb draw_subsets refit",
    "quest.robust.kernels.noise": "chance_inliers mark_typical typical_noise",
    "quest.robust.kernels.parallax": "anisotropy_sums depths_and_parallax pose_information ratio_sums rotation_of_all",
    "quest.robust.kernels.planes": "best_plane fit_plane off_line planar_information",
    "quest.robust.kernels.quest_five": "try_samples_of_five",
    "quest.robust.kernels.refinement": "refine refine_rotation",
    "quest.robust.kernels.rotations": "best_rotation",
    "quest.robust.kernels.samples": "try_poses",
    "quest.robust.kernels.scoring": "rays_by_row residuals residuals_of_model",
}
_MODULE_OF = {loop: module for module, loops in _LOOPS.items() for loop in loops.split()}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    loop = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = loop  # so that the next call finds it at once
    return loop
