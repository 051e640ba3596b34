"""The lens that the window uses, where the focal length is no calibration: an estimate that each window improves.

The focal length and the distortion are unknowns of every joint fit (:mod:`slam_init.window`). Of a calibrated camera
they stay where they are stated, within two per cent. Without a calibration the prior is wide. A fit far from the stated
lens is slow, and motions that are proposed with a wrong lens are poor. So the camera of the window follows the
estimate, and the prior stays where it was: an estimate is never the prior of the next one.
"""

from __future__ import annotations

from slam_init.config import Config
from slam_init.types.lens import CALIBRATED_SIGMA, MAX_FOCAL_SIGMA, CurrentLens, Lens, k1_sigma
from slam_init.window.levels import PRINCIPAL_SIGMA, READOUT_SIGMA_S
from slam_init.window.state import Priors

#: A current lens with a wider field than 90 degrees, or that bends the corners by a tenth, is one of an action camera.
#: The pinhole model with k1 does not describe such a lens, so that no motion determines its focal length.
#: Class: assumption, in sides of the image and as k1.
_WIDE_FOCAL, _WIDE_K1 = 0.5, -0.1
#: Factor on the probability that the lens of a machine's camera changes, as its data set states it: its focus is fixed
#: with a screw, and nothing stabilizes its images. What is left is a data set in such a layout by another camera.
#: Class: assumption.
_MACHINE_LENS_CHANGES = 0.01
#: Where a focal length comes from, by ``Camera.source``.
_ORIGINS = {
    "stated": "that was given",
    "file": "of the calibration file",
    "machine": "of the machine's camera",
    "metadata": "of the images' metadata",
    "estimated": "that was estimated",
}


def priors_of(lens: CurrentLens, config: Config) -> Priors:
    """What is known of the current lens before a fit."""
    stated = lens.stated
    return Priors(
        focal_sigma=stated.focal_sigma or CALIBRATED_SIGMA,
        k1_sigma=k1_sigma(stated),
        readout_sigma_s=READOUT_SIGMA_S if stated.readout_s is None else 0.0,
        principal_sigma_px=PRINCIPAL_SIGMA * stated.width,
        mean=Lens(-lens.log_scale, -lens.k1),
        lens_changes=config.acceptance.lens_changes * (_MACHINE_LENS_CHANGES if stated.source == "machine" else 1.0),
    )


def followed(lens: CurrentLens, found: Lens) -> CurrentLens:
    """The lens to go on with after an estimate: the same one, unless it is unknown and the estimate is far off."""
    log_scale, k1 = found.log_scale, found.k1
    # Half of what a calibration leaves open moves a pixel in the corner by a hundredth of its distance from the centre,
    # be it by the focal length or by the distortion.
    far = max(abs(log_scale), abs(k1)) > 0.5 * CALIBRATED_SIGMA
    return lens.moved(log_scale, k1) if lens.is_unknown and far else lens


def advice_on(lens: CurrentLens, focal_sigma: float) -> str | None:
    """What helps where the focal length stays unknown and the advice of the reason does not.

    * ``focal_sigma``: Relative standard deviation by the window, which may be larger than the stated one.
    """
    if lens.stated.source != "prior":
        return (
            f"the focal length {_ORIGINS[lens.stated.source]} is known to {focal_sigma:.1%} here, and at most "
            f"{MAX_FOCAL_SIGMA:.0%} is needed: turn the camera while it moves, or give the file of a calibration by "
            "--camera"
        )
    if lens.camera.focal_px < _WIDE_FOCAL * max(lens.camera.width, lens.camera.height) or lens.k1 < _WIDE_K1:
        return "wide lens: give its calibration by --camera FILE, or its field of view by --camera fov=DEGREES"
    return None
