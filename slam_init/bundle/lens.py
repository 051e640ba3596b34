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
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.lens import CALIBRATED_SIGMA, MAX_FOCAL_SIGMA, UNKNOWN_PRINCIPAL_SIGMA, LensPrior, k1_sigma


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
    found, across = camera.differentiated(problem.lenses[:, 2]), problem.lenses[:, :2]
    principal = np.broadcast_to(np.eye(2), (len(across), 2, 2))
    by_lens = np.concatenate(
        [(found.pixels - (camera.cx, camera.cy))[..., None], principal, found.by_k1[..., None]], axis=2
    )
    # The shortest move of the ray that takes the pixel back: a ray does not move along itself.
    seen: Bools = np.asarray(np.isfinite(found.pixels[:, 0]))
    J = np.where(seen[:, None, None], found.by_point, np.eye(2, 3))
    back = np.swapaxes(J, 1, 2) @ np.asarray(np.linalg.inv(J @ np.swapaxes(J, 1, 2)), np.float64)
    return np.asarray(np.nan_to_num(across @ back @ by_lens))
