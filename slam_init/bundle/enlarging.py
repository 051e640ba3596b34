"""The factor graph of a map of reduced images, in the pixels of the original ones."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from slam_init.bundle.reprojection import calibration_key, gtsam_calibration, measured_projection
from slam_init.types.camera import Camera

#: Parameters of a calibration of gtsam that are pixels: fx, fy, skew, cx, cy. The others are distortion.
_IN_PIXELS = 5


def enlarged_graph(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    camera: Camera,
    stated: Camera,
    factor: int,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Make the graph of the same map for images that are larger by a whole factor.

    * ``graph``: Made by :func:`slam_init.bundle.graph.build_graph`; the result has no robust kernel.
    * ``stated``: That of the larger images as stated, which a prior of the calibration expects.
    * Returns ``graph``: Each residual over its standard deviation is that of the given graph.
    """
    adjusted = values.exists(calibration_key())
    larger = gtsam.NonlinearFactorGraph()
    for number in range(graph.size()):
        one: Any = graph.at(number)  # its type is one of many that gtsam makes from templates
        name = type(one).__name__
        if name.startswith(("GenericProjectionFactor", "GeneralSFMFactor2")):
            pose, landmark = one.keys()[:2]
            sigma = 1 / float(one.noiseModel().unweightedWhiten(np.array([1.0, 0.0]))[0])
            noise = gtsam.noiseModel.Isotropic.Sigma(2, factor * sigma)
            pixel = factor * (np.asarray(one.measured(), np.float64) + 0.5) - 0.5
            larger.add(measured_projection(camera, pixel[None], noise, adjusted=adjusted)(0, pose, landmark))
        elif name.startswith("PriorFactorCal3"):
            larger.add(_enlarged_prior(one, stated, factor))
        else:
            larger.add(one)
    enlarged = gtsam.Values(values)
    if adjusted:
        enlarged.erase(calibration_key())
        enlarged.insert(calibration_key(), gtsam_calibration(camera, adjusted=True))
    return larger, enlarged


def _enlarged_prior(prior: Any, stated: Camera, factor: int) -> gtsam.NonlinearFactor:
    whiten = np.array(prior.noiseModel().R())
    whiten[:, :_IN_PIXELS] /= factor
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(whiten)
    larger: gtsam.NonlinearFactor = type(prior)(calibration_key(), gtsam_calibration(stated, adjusted=True), noise)
    return larger
