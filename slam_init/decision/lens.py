"""The lens that the window uses, where the focal length is no calibration: an estimate that each window improves.

The focal length and the distortion are unknowns of every joint fit (:mod:`slam_init.window`). Of a calibrated camera
they stay where they are stated, within two per cent. Without a calibration the prior is wide. A fit far from the stated
lens is slow, and motions that are proposed with a wrong lens are poor. So the camera of the window follows the
estimate, and the prior stays where it was: an estimate is never the prior of the next one.
"""

from __future__ import annotations

from slam_init.types.camera import Camera
from slam_init.window.levels import PRINCIPAL_SIGMA
from slam_init.window.state import CALIBRATED_SIGMA, Priors
from slam_init.window.uncertainty import CameraEstimate

#: Standard deviation of the first coefficient of the radial distortion. A calibration that states a distortion knows it
#: to a hundredth. Without one, most images are rectified or those of a good lens; those of phones and wide angles have
#: up to 0.3.
_STATED_K1_SIGMA, _UNSTATED_K1_SIGMA = 0.01, 0.05
#: A map without a calibration is handed over, and a calibration is written, once the focal length is about as well
#: known as by a data sheet (5 %). A focal length that is off by this much changes a rotation of 20 degrees by one, and
#: the depths by as much as itself; what it does to the direction is in the risk.
MAX_FOCAL_SIGMA = 0.06
#: A lens in use with a wider field than 90 degrees, or that bends the corners by a tenth, is one of an action camera.
#: The pinhole model with k1 does not describe such a lens, so that no motion tells its focal length.
_WIDE_FOCAL, _WIDE_K1 = 0.5, -0.1
#: The camera follows an estimate that differs by more: half of what a calibration leaves open, which moves a pixel in
#: the corner by a hundredth of its distance from the centre, be it by the focal length or by the distortion.
_FOLLOWED = 0.01


class WindowLens:
    """The camera of the window, and what was known of its lens before.

    * ``stated``: With ``focal_sigma`` where the focal length is no calibration.
    * ``camera``: The stated camera with the lens in use.
    * ``is_unknown``: Whether the focal length is estimated.
    """

    def __init__(self, stated: Camera) -> None:
        self.stated = stated
        self.camera = stated
        self.is_unknown = stated.focal_sigma is not None and stated.focal_sigma > CALIBRATED_SIGMA
        self._log_scale, self._k1 = 0.0, 0.0

    def priors(self, readout_sigma_s: float) -> Priors:
        """What is known of the lens in use before a fit."""
        return Priors(
            focal_sigma=self.stated.focal_sigma or CALIBRATED_SIGMA,
            k1_sigma=_STATED_K1_SIGMA if self.stated.is_distorted else _UNSTATED_K1_SIGMA,
            readout_sigma_s=readout_sigma_s,
            principal_sigma_px=PRINCIPAL_SIGMA * self.stated.width,
            log_scale_mean=-self._log_scale,
            k1_mean=-self._k1,
        )

    @property
    def log_scale(self) -> float:
        """Logarithm of the focal length in use over the stated one."""
        return self._log_scale

    @property
    def k1(self) -> float:
        """What is added to the first coefficient of the stated distortion."""
        return self._k1

    def advice(self) -> str | None:
        """What helps where the focal length stays unknown and the advice of the reason does not."""
        if self.stated.source != "prior":
            percent = 100 * (self.stated.focal_sigma or 0.0)
            return (
                f"the given focal length (+- {percent:.2g} %) is not certain enough here: turn the camera while it "
                "moves, or give the file of a calibration by --camera"
            )
        if self.camera.focal_px < _WIDE_FOCAL * max(self.camera.width, self.camera.height) or self._k1 < _WIDE_K1:
            return "wide lens: give its calibration by --camera FILE, or its field of view by --camera fov=DEGREES"
        return None

    def step(self, found: CameraEstimate) -> tuple[float, float]:
        """How far the lens in use has to move to the estimate."""
        if not self.is_unknown:
            return 0.0, 0.0
        log_scale, k1 = found.focal.log_scale, found.distortion.k1
        return (log_scale, k1) if max(abs(log_scale), abs(k1)) > _FOLLOWED else (0.0, 0.0)

    def follow(self, log_scale: float, k1: float) -> None:
        """Move the lens in use."""
        self._log_scale += log_scale
        self._k1 += k1
        self.camera = self.camera.refocused(log_scale, k1)
