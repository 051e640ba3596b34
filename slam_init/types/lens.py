"""Lenses that are not known exactly: how one differs from a camera, what is known of it, and the one in use.

Where the focal length is no calibration, each evaluated window improves it. The rays of a history are those of one such
lens (:class:`slam_init.types.history.History`), and whoever needs the camera asks the history.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

#: Relative standard deviation of the focal length of a calibration: they are better than two per cent.
#: Class: assumption.
CALIBRATED_SIGMA = 0.02
#: A map without a calibration is accepted, and a calibration is written, once the focal length is about as well
#: known as by a data sheet (5 %). A focal length that is off by this much changes a rotation of 20 degrees by one, and
#: the depths by as much as itself; what it does to the direction is in the risk.
#: Class: geometry.
MAX_FOCAL_SIGMA = 0.06
#: Standard deviation of the first coefficient of the radial distortion. A calibration that states a distortion knows it
#: to a hundredth. Without one, most images are rectified or those of a good lens; those of phones and wide angles have
#: up to 0.3.
#: Class: assumption.
_STATED_K1_SIGMA, _UNSTATED_K1_SIGMA = 0.01, 0.05
#: The same of a lens of which nothing is known: wide ones have a k1 of up to -.3.
#: Class: assumption.
UNKNOWN_K1_SIGMA = 0.15
#: Standard deviation of each coordinate of a principal point that nobody calibrated, over the width of the image: the
#: optical axis of phones is off by a hundredth, that of a cropped or shifted image by a twentieth.
#: Class: assumption, over the width.
UNKNOWN_PRINCIPAL_SIGMA = 0.025
#: A lens beyond its prior compensates errors that the model does not have. One that is off by two standard deviations
#: widens the deviations of a fit by sqrt(2), one that is off by more in proportion, as Student's distribution with so
#: many degrees of freedom is wider than a Gaussian one far out.
#: Class: assumption.
PULL_FREEDOM = 4.0


def k1_sigma(stated: Camera) -> float:
    """Standard deviation of the first coefficient of the radial distortion about that of a stated camera."""
    return _STATED_K1_SIGMA if stated.is_distorted else _UNSTATED_K1_SIGMA


class Lens(NamedTuple):
    """How a lens differs from a camera: in a joint fit from the camera in use."""

    #: Logarithm of the focal length over that of the camera.
    log_scale: float = 0.0
    #: Added to the first coefficient of the radial distortion.
    k1: float = 0.0
    #: Readout of the image, in seconds.
    readout_s: float = 0.0
    #: Added to the principal point.
    principal_px: tuple[float, float] = (0.0, 0.0)

    def centred(self) -> Lens:
        """The same lens with the stated principal point, of which one window has little information."""
        return self._replace(principal_px=(0.0, 0.0))


#: The lens of the camera itself, without a readout.
SAME_LENS = Lens()


@dataclass(frozen=True)
class LensPrior:
    """What is known of a lens: before a fit, or by it.

    The standard deviations are about ``mean``; 0 for what is known exactly.
    """

    #: Relative, of the focal length.
    focal_sigma: float = CALIBRATED_SIGMA
    #: Of the first coefficient of the radial distortion.
    k1_sigma: float = _UNSTATED_K1_SIGMA
    #: Of the readout of a rolling shutter, in seconds; 0 where the rays are corrected already, or the fit holds it.
    readout_sigma_s: float = 0.0
    #: Of each coordinate of the principal point.
    principal_sigma_px: float = 0.0
    #: What is expected. It is not that of the camera where this is an estimate, and the prior that of an earlier one.
    mean: Lens = SAME_LENS
    #: Focal length, principal point (2) and k1: whether the camera of a map has the value by the tracks, and not
    #: the expected one. Only then their information lowers the deviation.
    fitted: tuple[bool, bool, bool, bool] = (False, False, False, False)

    @property
    def sigmas(self) -> Floats:
        """The standard deviations of focal length, principal point (2) and k1.

        Shapes: returns (4,).
        """
        return np.array([self.focal_sigma, self.principal_sigma_px, self.principal_sigma_px, self.k1_sigma])


@dataclass(frozen=True)
class CurrentLens:
    """A camera, and how far its lens is from the stated one."""

    camera: Camera
    #: With ``focal_sigma`` where the focal length is no calibration.
    stated: Camera
    #: Logarithm of the focal length in use over the stated one.
    log_scale: float = 0.0
    #: What is added to the first coefficient of the stated distortion.
    k1: float = 0.0

    @staticmethod
    def of(stated: Camera) -> CurrentLens:
        """The stated lens."""
        return CurrentLens(stated, stated)

    @property
    def is_unknown(self) -> bool:
        """Whether the focal length is estimated."""
        return self.stated.focal_sigma is not None and self.stated.focal_sigma > CALIBRATED_SIGMA

    def moved(self, log_scale: float, k1: float) -> CurrentLens:
        """Another current lens; the stated one stays."""
        if log_scale == k1 == 0.0:
            return self
        camera = self.camera.refocused(log_scale, k1)
        return CurrentLens(camera, self.stated, self.log_scale + log_scale, self.k1 + k1)
