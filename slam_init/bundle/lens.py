"""The lens of a map: what its calibration leaves open, and how the residuals follow it.

The map holds the lens as it is stated. What the calibration leaves open moves all views and points together, so it does
not average out over tracks: it has a variable of its own in the graph, and its part in the covariances.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.least_squares import with_lenses
from slam_init.bundle.problem import BundleProblem
from slam_init.config import MapConfig
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.lens import CALIBRATED_SIGMA, MAX_FOCAL_SIGMA, UNKNOWN_PRINCIPAL_SIGMA, LensPrior, k1_sigma

#: Steps of the derivatives. Poses and points follow most of a change of the lens, and a millionth of what is left may
#: count: errors of a thousandth of the derivatives would have as much weight in the focal length as a turning camera
#: has.
_STEP, _PIXEL_STEP = 1e-6, 1e-3


def lens_prior(stated: Camera, config: MapConfig) -> LensPrior:
    """What is known of the lens besides the tracks.

    * ``stated``: The camera before the adjustment of its focal length.
    """
    share = config.lens_uncertainty
    focal = share * min(stated.focal_sigma or CALIBRATED_SIGMA, MAX_FOCAL_SIGMA)
    estimated = (stated.focal_sigma or 0.0) > CALIBRATED_SIGMA
    return LensPrior(
        focal_sigma=config.focal_sigma if config.refine_focal else focal,
        k1_sigma=share * k1_sigma(stated),
        principal_sigma_px=share * UNKNOWN_PRINCIPAL_SIGMA * stated.width,
        fitted=(config.refine_focal or estimated, False, False, estimated),
    )


def at_projections(camera: Camera, problem: BundleProblem) -> BundleProblem:
    """The same problem without residuals: each landmark is observed where it projects to.

    The equations of a problem with residuals count products of residuals as information about the lens.
    """
    return with_lenses(camera, replace(problem, pixels=problem.pixels + problem.residuals(camera)))


def residuals_of(projected: BundleProblem, measured: BundleProblem) -> Floats:
    """The residuals of a problem in the virtual cameras of its projections.

    Shapes: returns (M, 2).

    * ``projected``: Of :func:`at_projections`.
    """
    if projected.lenses is None or measured.lenses is None:
        raise ValueError("a problem without lenses: make them by with_lenses")
    rays = projected.lenses[:, 2] - measured.lenses[:, 2]
    return np.asarray(np.einsum("mij,mj->mi", projected.lenses[:, :2], rays))


def lens_derivatives(camera: Camera, problem: BundleProblem) -> Floats:
    """How the residuals in the virtual cameras follow the lens: log focal length, principal point (2), k1.

    Another lens sees the same pixel along another ray. That moves the residual by the move of the ray. An error of a
    measured pixel moves it as an error of the principal point does, with the other sign.

    Shapes: returns (M, 2, 4).

    * ``problem``: Of :func:`at_projections`.
    * Returns: 0 where another lens does not see the pixel.
    """
    if problem.lenses is None:
        raise ValueError("a problem without lenses: make them by with_lenses")
    rays, across = problem.lenses[:, 2], problem.lenses[:, :2]
    others = (
        (camera.refocused(_STEP), _STEP),
        (replace(camera, cx=camera.cx + _PIXEL_STEP), _PIXEL_STEP),
        (replace(camera, cy=camera.cy + _PIXEL_STEP), _PIXEL_STEP),
        (camera.bent(_STEP), _STEP),
    )
    moves = np.stack([(other.bearings(problem.pixels) - rays) / step for other, step in others], axis=-1)
    return np.nan_to_num(-across @ moves)
