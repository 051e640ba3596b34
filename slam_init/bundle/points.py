"""The points of a map for poses that are known: each one for itself, robustly.

The joint fit of a window knows its poses from a robust estimate already. What bundle adjustment would find in a first,
robust stage are the points, and the observations that are outliers. For held poses the points are independent of each
other, so that this takes a millisecond for thousands of observations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.graph import CAUCHY
from slam_init.bundle.problem import BundleProblem
from slam_init.types.camera import Camera

#: The fifth step moves a typical point by a hundred-thousandth of its distance, and one in twenty by more than 2 in ten
#: thousand (300 drawn points in views with .5 px of noise and 10 % outliers, from distances off by 5 %).
_STEPS = 5
#: Added to the equations of a point, as a share of their trace: points without parallax stay where they are.
_DAMPING = 1e-6


def fit_points(camera: Camera, problem: BundleProblem, noise_px: float) -> BundleProblem:
    """Fit the points to their rays with a Cauchy kernel, for the poses of a problem.

    * Returns: With other points. A point that a step would move behind a camera stays where it is.
    """
    from slam_init.bundle.kernel import fit_points_to_rays

    rays = camera.bearings(problem.pixels) if problem.lenses is None else problem.lenses[:, 2]
    R = np.array([pose.R for pose in problem.world_from_cam])[problem.views]
    order = np.argsort(problem.landmarks, kind="stable")
    world = np.einsum("mij,mj->mi", R, rays)[order]
    starts = np.concatenate([[0], np.cumsum(np.bincount(problem.landmarks, minlength=len(problem.points)))])
    centres = np.array([pose.t for pose in problem.world_from_cam])
    points, scale_rad = np.array(problem.points, np.float64), CAUCHY * noise_px / camera.focal_px
    fit_points_to_rays(points, starts, problem.views[order], centres, world, scale_rad, _DAMPING, _STEPS)
    return replace(problem, points=points)
