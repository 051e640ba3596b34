"""What a window found, as the evidence of an attempt."""

from __future__ import annotations

import math

from slam_init.decision.lens import WindowLens
from slam_init.types.evidence import RotationOnlyEvidence, WindowEvidence
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.risk import WindowRisk

#: A focal length is suspected only if it is off by a hundredth or more, the error of a careless calibration, and by
#: five of its standard deviations: errors that the tracks share double them. Five hundredths have to be told.
_LEAST_FOCAL_ERROR, _DOUBTFUL_SIGMAS, _TOLD_FOCAL_ERROR = 0.01, 5.0, 0.05


def window_evidence(hypotheses: WindowHypotheses, risk: WindowRisk, lens: WindowLens) -> WindowEvidence:
    """State what the window found."""
    best = hypotheses.motions[0]
    distortion, readout = risk.camera.distortion, risk.camera.readout
    rolling = None if readout is None else lens.camera.with_readout(readout.seconds)
    return WindowEvidence(
        views=len(best.rows),
        hypotheses=len(hypotheses.motions),
        planar=hypotheses.planar,
        risk=risk.total,
        risk_direction=risk.direction,
        risk_rival=risk.rival,
        risk_rotation=risk.rotation,
        risk_moving=risk.moving,
        risk_floor=risk.floor,
        direction_sigma_deg=risk.direction_sigma_deg,
        rotation_sigma_deg=risk.rotation_sigma_deg,
        depth_sigma=risk.depth_sigma,
        noise_px=hypotheses.tracks.noise_px,
        field_px=risk.field_px,
        rotation_log_likelihood=risk.rotation_log_likelihood,
        focal_factor=math.exp(lens.log_scale + risk.camera.focal.log_scale),
        focal_sigma=risk.camera.focal.sigma,
        readout_ms=None if rolling is None else rolling.readout_ms,
        readout_direction=None if rolling is None else rolling.readout_direction,
        readout_sigma_ms=None if readout is None else 1e3 * readout.sigma_s,
        distortion_k1=lens.k1 + distortion.k1,
        distortion_sigma=distortion.sigma,
        suspected_distortion=None if lens.is_unknown else distortion.suspected,
    )


def rotation_evidence(hypotheses: WindowHypotheses) -> RotationOnlyEvidence | None:
    """The focal length of the rotation-only camera, and whether it casts doubt on the stated one.

    * Returns: None where the camera rotated too little to tell a focal length that is off by five hundredths.
    """
    log_scale, sigma = hypotheses.focal_of_rotation
    doubtful = abs(log_scale) >= _LEAST_FOCAL_ERROR and abs(log_scale) > _DOUBTFUL_SIGMAS * sigma
    if not doubtful and _DOUBTFUL_SIGMAS * sigma > _TOLD_FOCAL_ERROR:
        return None
    factor = math.exp(log_scale)
    return RotationOnlyEvidence(factor, factor if doubtful else None)
