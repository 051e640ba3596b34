"""Decision rules for the relative pose of a pair, before any map is built.

The direction error has three bounds, since it has three sources: the noise of single tracks, the correlated error of
neighbouring tracks, and bodies in a part of the image that move by themselves. All three have to be small enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import NoPose, RelativePose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle
from slam_init.config import Config
from slam_init.decision.refusal import refused_at, refused_by, with_gates
from slam_init.decision.rotation_only import RotationOnlyCamera
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.frontend.tracks import History, common_tracks
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.evidence import TwoViewEvidence
from slam_init.types.frame import Observations
from slam_init.types.gates import GateName, Stage, at_least, at_most
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

__all__ = [
    "MatchedPair",
    "TwoViewEstimate",
    "judge_rotation",
    "judge_two_views",
    "match_pair",
    "pose_at_fitting_threshold",
    "pose_evidence",
    "two_view_evidence",
]

#: The outlier threshold should be three standard deviations of the noise. Where the noise of the inliers is more than
#: half of the threshold, the threshold has cut off many correct matches: inliers that fill the threshold evenly have a
#: standard deviation of 0.58 of it. The threshold is then widened once by a factor of three, from the value for a noise
#: of 0.7 px to the value for a noise of 2 px.
_TOO_NOISY_SIGMAS, _WIDER = 2.0, 3.0


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The matches of a pair: the tracks that both views see.

    Attributes
    ----------
    preview : PairPreview
    reference, current : Observations
        The two views, in time order.
    pixels1, pixels2 : (N, 2) float
        Raw pixels in the reference and in the current view.
    rays1, rays2 : (N, 3) float
        Unit bearings in the two camera frames.
    """

    preview: PairPreview
    reference: Observations
    current: Observations
    pixels1: Floats
    pixels2: Floats
    rays1: Floats
    rays2: Floats


@dataclass(frozen=True, eq=False)
class TwoViewEstimate:
    """The relative pose of a pair, and the bounds of its direction error.

    Attributes
    ----------
    pose : RelativePose
        ``cam2_from_cam1``, with its alternatives.
    threshold_rad : float
        Outlier threshold of the estimate.
    rotation_only : RotationOnlyCamera
        The rival explanation of the inliers by a camera that only rotates, with a free focal length.
    correlated_rad : float
        Correlated tracking error, in radians of a bearing.
    correlated_turn_rad : float
        Angle by which this error may turn the baseline.
    jackknife_rad : float
        Standard deviation of the direction by leaving out parts of the image (:mod:`quest.jackknife`); 0 for a pure
        rotation.
    """

    pose: RelativePose
    threshold_rad: float
    rotation_only: RotationOnlyCamera
    correlated_rad: float
    correlated_turn_rad: float
    jackknife_rad: float


def match_pair(history: History, preview: PairPreview, current: Observations) -> MatchedPair:
    """Gather the tracks that the reference of a pair and the current frame have in common.

    Parameters
    ----------
    history : History
        Holds the reference frame.
    preview : PairPreview
    current : Observations

    Returns
    -------
    MatchedPair
    """
    reference = history[preview.reference]
    i, j = common_tracks(reference, current)
    return MatchedPair(
        preview=preview,
        reference=reference,
        current=current,
        pixels1=reference.pixels[i],
        pixels2=current.pixels[j],
        rays1=reference.bearings[i],
        rays2=current.bearings[j],
    )


def pose_at_fitting_threshold(camera: Camera, config: Config, pair: MatchedPair) -> tuple[RelativePose | NoPose, float]:
    """Estimate the relative pose of a pair; the outlier threshold is widened once for noisy tracks.

    Parameters
    ----------
    camera : Camera
    config : Config
    pair : MatchedPair

    Returns
    -------
    pose : RelativePose or NoPose
    threshold_rad : float
        The outlier threshold that was used.
    """
    threshold_rad = config.two_view.threshold_px / camera.focal_px
    pose = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=threshold_rad, seed=config.seed)
    if isinstance(pose, RelativePose) and pose.noise_rad > threshold_rad / _TOO_NOISY_SIGMAS:
        wider_rad = min(_WIDER * threshold_rad, 1.0)
        again = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=wider_rad, seed=config.seed)
        if isinstance(again, RelativePose) and again.kind != "rotation":
            return again, wider_rad
    return pose, threshold_rad


def pose_evidence(camera: Camera, pose: RelativePose | NoPose) -> TwoViewEvidence:
    """Return the figures of a relative pose as evidence of an attempt.

    Parameters
    ----------
    camera : Camera
        Converts angles to pixels.
    pose : RelativePose or NoPose

    Returns
    -------
    TwoViewEvidence
        With the statistics alone where no pose was found.
    """
    if isinstance(pose, NoPose):
        return TwoViewEvidence(pose.evidence)
    return TwoViewEvidence(
        statistics=pose.evidence,
        kind=pose.kind,
        alternatives=len(pose.alternatives),
        noise_px=pose.noise_rad * camera.focal_px,
        parallax_deg=float(np.degrees(pose.parallax_rad)),
        direction_sigma_deg=float(np.degrees(pose.direction_sigma_rad)),
    )


def two_view_evidence(camera: Camera, estimate: TwoViewEstimate | NoPose) -> TwoViewEvidence:
    """Return the figures of a two-view estimate as evidence of an attempt.

    Parameters
    ----------
    camera : Camera
        Converts angles to pixels.
    estimate : TwoViewEstimate or NoPose

    Returns
    -------
    TwoViewEvidence
        With the statistics alone where no pose was found.
    """
    if isinstance(estimate, NoPose):
        return pose_evidence(camera, estimate)
    correlated_px = estimate.correlated_rad * camera.focal_px
    return replace(pose_evidence(camera, estimate.pose), correlated_error_px=correlated_px)


def judge_two_views(camera: Camera, config: Config, attempt: Attempt, estimate: TwoViewEstimate) -> Attempt:
    """Refuse a pair whose two views show no translation, or determine its direction too poorly.

    Parameters
    ----------
    camera : Camera
    config : Config
    attempt : Attempt
    estimate : TwoViewEstimate

    Returns
    -------
    Attempt
        With the gates of this stage; its verdict is still ``accepted`` if all of them pass.
    """
    if estimate.pose.kind == "rotation":
        return judge_rotation(camera, config, attempt, estimate.pose)
    return _judge_direction(config, attempt, estimate)


def judge_rotation(camera: Camera, config: Config, attempt: Attempt, pose: RelativePose) -> Attempt:
    """Refuse a pure rotation; a static camera if the rotation is within the noise that it was fitted to.

    Parameters
    ----------
    camera : Camera
    config : Config
    attempt : Attempt
    pose : RelativePose
        Of kind "rotation".

    Returns
    -------
    Attempt
    """
    least_px = difference_gate(max(config.map.noise_px, pose.noise_rad * camera.focal_px))
    rotation_px = float(rotation_angle(pose.R)) * camera.focal_px
    gate = at_least(GateName.ROTATION_PX, rotation_px, least_px, Verdict.STATIC_CAMERA)
    attempt = with_gates(attempt, (gate,))
    if not gate.passes():
        return refused_by(attempt, Stage.MOTION, (gate,))
    return refused_at(attempt, Verdict.PURE_ROTATION, Stage.MOTION)


def _judge_direction(config: Config, attempt: Attempt, estimate: TwoViewEstimate) -> Attempt:
    pose, settings = estimate.pose, config.acceptance
    max_deg = settings.max_direction_error_deg
    # Further views and bundle adjustment lower the standard deviation by about the square root of the number of views.
    # Therefore one standard deviation is compared with the bound here, and three standard deviations in the map.
    sigma_deg = float(np.degrees(pose.direction_sigma_rad))
    by_noise = (
        at_least(
            GateName.INLIER_SHARE,
            float(pose.inliers.mean()),
            config.two_view.min_inlier_share,
            Verdict.NO_CONSISTENT_MOTION,
        ),
        at_most(GateName.TWO_VIEW_DIRECTION_SIGMA_DEG, sigma_deg, max_deg, Verdict.LOW_PARALLAX),
        at_most(
            GateName.DIRECTION_CORRELATED_DEG,
            float(np.degrees(estimate.correlated_turn_rad)),
            max_deg,
            Verdict.LOW_PARALLAX,
            "translate further: the motion of the tracks is nearly that of a pure rotation",
        ),
    )
    jackknife = at_most(
        GateName.DIRECTION_JACKKNIFE_DEG,
        min(3 * float(np.degrees(estimate.jackknife_rad)), 180.0),
        max_deg,
        Verdict.LOW_PARALLAX,
        "parts of the view disagree on the direction of motion: translate further, and look at static objects",
    )
    gates = (*by_noise, jackknife)
    attempt = with_gates(attempt, gates)
    if all(gate.passes() for gate in gates):
        return attempt
    refused = refused_by(attempt, Stage.TWO_VIEWS, gates)
    if refused.verdict != Verdict.LOW_PARALLAX:
        return refused
    # The gates by noise predict how much longer the baseline has to be. The jackknife does not, since it is computed
    # from a dozen fits and jumps from frame to frame.
    return replace(refused, parallax_shortfall=max(gate.parallax_shortfall() for gate in by_noise))
