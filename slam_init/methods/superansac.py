"""SupeRANSAC's essential matrix with the default settings of its package; an optional package.

References
----------
.. [1] D. Barath, "SupeRANSAC: One RANSAC to Rule Them All", arXiv:2506.04803, 2025; the package ``pysuperansac``,
   ``estimateEssentialMatrix``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.methods.essential import EssentialMethod, Motions
from slam_init.methods.motions import motions_of_essential
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera


@dataclass(frozen=True)
class SupeRansac(EssentialMethod):
    """Five-point RANSAC with MAGSAC scores and nested local optimization [1]_, then cheirality and a parallax gate.

    The constants are the defaults of ``pysuperansac`` 1.0. One setting departs from them: samples are drawn uniformly.
    The default, PROSAC, needs matches in the order of their quality, and tracks have no such order. The random
    generator of the package cannot be seeded, so that two runs can differ. The package raises an error for fewer than
    six matches.
    """

    #: Largest scale of the noise of an inlier.
    threshold_px: float = 1.5
    confidence: float = 0.99
    min_iterations: int = 1000
    max_iterations: int = 5000

    def motions(self, camera: Camera, pixels1: Floats, pixels2: Floats, seed: int) -> Motions | None:
        """Estimate the essential matrix; None where there is none."""
        import pysuperansac

        settings = pysuperansac.RANSACSettings()
        settings.inlier_threshold = self.threshold_px
        settings.confidence = self.confidence
        settings.min_iterations, settings.max_iterations = self.min_iterations, self.max_iterations
        settings.sampler = pysuperansac.SamplerType.Uniform
        sizes = [float(camera.width), float(camera.height)] * 2
        matches = np.hstack([pixels1, pixels2])
        E, found, _, _ = pysuperansac.estimateEssentialMatrix(matches, camera.K, camera.K, sizes, [], settings)
        inliers = np.zeros(len(pixels1), bool)
        inliers[np.asarray(found, int)] = True
        E = np.asarray(E, float)
        if E.shape != (3, 3) or not inliers.any() or not np.isfinite(E).all():
            return None
        return *motions_of_essential(E), inliers
