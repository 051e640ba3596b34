"""SupeRANSAC's essential matrix with the default settings of its package; an optional package.

References
----------
.. [1] D. Barath, "SupeRANSAC: One RANSAC to Rule Them All", arXiv:2506.04803, 2025; the package ``pysuperansac``,
   ``estimateEssentialMatrix``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slam_init.methods.gates import GATED_PAIRS, GateRules, accept_best
from slam_init.methods.motions import motions_of_essential
from slam_init.methods.two_view import TwoViewOutcome, check_matches
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.reasons import Verdict


@dataclass(frozen=True)
class SupeRansacRules:
    """The constants of ``superansac``: the defaults of ``pysuperansac`` 1.0."""

    #: Largest scale of the noise of an inlier.
    threshold_px: float = 1.5
    confidence: float = 0.99
    min_iterations: int = 1000
    max_iterations: int = 5000
    #: The package raises an error for fewer matches.
    min_matches: int = 6
    gates: GateRules = field(default_factory=GateRules)


class SupeRansac:
    """Five-point RANSAC with MAGSAC scores and nested local optimization [1]_, then cheirality and a parallax gate.

    Departs from the defaults of the package in one setting: samples are drawn uniformly. The default, PROSAC, needs
    matches in the order of their quality, and tracks have no such order. The random generator of the package cannot be
    seeded, so that two runs can differ.
    """

    pair_rule = GATED_PAIRS

    def __init__(self, rules: SupeRansacRules | None = None) -> None:
        self.rules = rules or SupeRansacRules()

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept or refuse a pair; see :meth:`slam_init.methods.two_view.TwoViewMethod.bootstrap`."""
        import pysuperansac

        count, rules = check_matches(pixels1, pixels2, bearings1, bearings2), self.rules
        if count < rules.min_matches:
            return TwoViewOutcome.refused(Verdict.TOO_FEW_MATCHES, count, {"matches_needed": rules.min_matches})
        settings = pysuperansac.RANSACSettings()
        settings.inlier_threshold = rules.threshold_px
        settings.confidence = rules.confidence
        settings.min_iterations, settings.max_iterations = rules.min_iterations, rules.max_iterations
        settings.sampler = pysuperansac.SamplerType.Uniform
        sizes = [float(camera.width), float(camera.height)] * 2
        matches = np.hstack([pixels1, pixels2])
        E, found, _, _ = pysuperansac.estimateEssentialMatrix(matches, camera.K, camera.K, sizes, [], settings)
        inliers = np.zeros(count, bool)
        inliers[np.asarray(found, int)] = True
        E = np.asarray(E, float)
        if E.shape != (3, 3) or not inliers.any() or not np.isfinite(E).all():
            return TwoViewOutcome.refused(Verdict.NO_CONSISTENT_MOTION, count)
        R, t = motions_of_essential(E)
        return accept_best(camera, R, t, bearings1, bearings2, inliers, rules.gates, {})
