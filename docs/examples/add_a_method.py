"""Add an initialization method in 20 lines: a class that takes the matches of two views.

The class need not be registered. Every command accepts its import path: ::

    slam-init run --method docs/examples/add_a_method.py:MedianParallax

The example uses the RANSAC of OpenCV and requires a median parallax of two degrees. The map of a method is adjusted,
written and recorded in the same way as every other map.
"""

from __future__ import annotations

import numpy as np

from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential
from slam_init.methods.two_view import PairRule, TwoViewOutcome, check_matches
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera


class MedianParallax:
    """A method that implements :class:`slam_init.methods.two_view.TwoViewMethod`."""

    pair_rule = PairRule(min_features=50, min_matches=50, min_landmarks=50)

    def bootstrap(
        self, camera: Camera, pixels1: Floats, pixels2: Floats, bearings1: Floats, bearings2: Floats, seed: int
    ) -> TwoViewOutcome:
        """Accept a motion between two views, or refuse the pair with a reason.

        Shapes: ``pixels1, pixels2`` (N, 2), ``bearings1, bearings2`` (N, 3).

        * ``seed``: Seed of random draws; OpenCV has its own fixed seed, so this method does not use it.
        """
        import cv2

        count = check_matches(pixels1, pixels2, bearings1, bearings2)
        E, mask = cv2.findEssentialMat(pixels1, pixels2, camera.K, cv2.RANSAC, 0.999, 1.0)
        if E is None or E.shape != (3, 3):
            return TwoViewOutcome.refused("no_consistent_motion", count)
        inliers = np.asarray(mask.ravel() > 0)
        rule = CheckRule(max_error_px=2.0, distant_cos=1.0, ranked=int(inliers.sum()) // 2)
        check = check_motions(camera, *motions_of_essential(np.asarray(E, float)), bearings1, bearings2, inliers, rule)
        best = int(np.argmax(check.good.sum(axis=1)))
        evidence: dict[str, float | int | str] = {
            "parallax_deg": float(check.parallax_deg[best]),
            "parallax_deg_gate": 2.0,
        }
        if check.parallax_deg[best] < 2.0:
            return TwoViewOutcome.refused("low_parallax", count, evidence)
        return TwoViewOutcome.accepted(check.pose(best), check.landmarks[best], check.points[best], False, evidence)
