"""The rule "window": one number decides, the risk that the map of the best hypothesis is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis
from quest.geometry.quaternion import quaternion_from_matrix
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.refusal import refused_at, refused_by, with_gates
from slam_init.decision.two_views import MatchedPair, TwoViewEstimate
from slam_init.frontend.tracks import History
from slam_init.mapping.candidate import MapCandidate, build_candidate
from slam_init.mapping.views import further_views, table_of, voting_views
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.evidence import MapEvidence, WindowEvidence
from slam_init.types.gates import GateName, Stage, at_least, at_most
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt
from slam_init.window.hypotheses import FittedMotion, WindowHypotheses, fit_hypotheses
from slam_init.window.joint_fit import Priors
from slam_init.window.risk import WindowRisk, risk_of
from slam_init.window.tracks import MAX_VIEWS, gather_tracks

__all__ = ["WINDOW_PRIORS", "WindowDecision", "judge_by_window"]

#: Standard deviation of each coefficient of a view's error field, in pixels: two thirds of the least correlated
#: tracking error that the gates assume (0.15 px), since six terms together have about 1.5 times the rms of one.
_FIELD_SIGMA_PX = 0.1
#: Prior of the focal length: calibrations are better than this, data sheets are worse.
_FOCAL_SIGMA = 0.03
#: What is known of the camera before the fit.
WINDOW_PRIORS = Priors(_FOCAL_SIGMA, _FIELD_SIGMA_PX)


@dataclass(frozen=True, eq=False)
class WindowDecision:
    """What the window decided about a pair.

    Attributes
    ----------
    attempt : Attempt
        With its verdict and evidence.
    maps : tuple of MapCandidate
        The map of the best hypothesis where it was accepted; both maps of an undecided plane; else empty.
    margin : Margin or None
        The vote against the nearest rival; None without a rival.
    """

    attempt: Attempt
    maps: tuple[MapCandidate, ...] = ()
    margin: Margin | None = None


def judge_by_window(
    camera: Camera,
    config: Config,
    history: History,
    attempt: Attempt,
    pair: MatchedPair,
    estimate: TwoViewEstimate,
) -> WindowDecision:
    """Fit all views of the window jointly for each motion of the pair, and accept the best where its risk is small.

    Parameters
    ----------
    camera : Camera
    config : Config
    history : History
        Holds the further views.
    attempt : Attempt
    pair : MatchedPair
    estimate : TwoViewEstimate
        Its pose is not of kind "rotation".

    Returns
    -------
    WindowDecision
    """
    pose, reference, current = estimate.pose, pair.reference, pair.current
    noise_px = max(config.map.min_noise_px, pose.noise_rad * camera.focal_px)
    views = voting_views(history, reference, current, replace(config.map, max_voting_views=MAX_VIEWS - 2))
    tracks = gather_tracks(camera, [reference, current, *views], noise_px)
    hypotheses = fit_hypotheses(tracks, pose, pair.rays1, pair.rays2, WINDOW_PRIORS)
    risk = risk_of(hypotheses)
    attempt = replace(attempt, window=_evidence(hypotheses, risk))
    gate = at_most(GateName.RISK, risk.total, config.acceptance.max_risk, *_reason(hypotheses, risk))
    attempt = with_gates(attempt, (gate,))
    if not gate.passes():
        refused = replace(refused_by(attempt, Stage.MAP, (gate,)), parallax_shortfall=1.0)
        undecided = hypotheses.motions[:2] if refused.verdict == Verdict.AMBIGUOUS_PLANE else ()
        maps = [_map(camera, config, history, pair, motion, estimate.threshold_rad) for motion in undecided]
        solved = tuple(one for one in maps if isinstance(one.bundle, BundleSolution))
        return WindowDecision(refused, solved if len(solved) == 2 else (), risk.margin)
    candidate = _map(camera, config, history, pair, hypotheses.motions[0], estimate.threshold_rad)
    return replace(_usable(config, attempt, candidate), margin=risk.margin)


def _evidence(hypotheses: WindowHypotheses, risk: WindowRisk) -> WindowEvidence:
    best = hypotheses.motions[0]
    return WindowEvidence(
        views=len(best.rows),
        hypotheses=len(hypotheses.motions),
        planar=hypotheses.planar,
        risk=risk.total,
        risk_direction=risk.direction,
        risk_rival=risk.rival,
        risk_rotation=risk.rotation,
        risk_floor=risk.floor,
        direction_sigma_deg=risk.direction_sigma_deg,
        rotation_sigma_deg=risk.rotation_sigma_deg,
        rotation_log_likelihood=risk.rotation_log_likelihood,
        focal_factor=float(np.exp(best.fit.state.log_scale)),
    )


def _reason(hypotheses: WindowHypotheses, risk: WindowRisk) -> tuple[Verdict, str | None]:
    """The verdict and the advice for the largest term of the risk."""
    if risk.rotation >= max(risk.rival, risk.direction):
        return Verdict.PURE_ROTATION, None
    if risk.rival >= risk.direction:
        if hypotheses.planar:
            return Verdict.AMBIGUOUS_PLANE, None
        return Verdict.LOW_PARALLAX, "two motions explain the tracks: translate further, best sideways"
    return Verdict.LOW_PARALLAX, None


def _map(
    camera: Camera,
    config: Config,
    history: History,
    pair: MatchedPair,
    motion: FittedMotion,
    threshold_rad: float,
) -> MapCandidate:
    """The bundle-adjusted map of a fitted motion."""
    pose = motion.cam2_from_cam1
    hypothesis = Hypothesis(quaternion_from_matrix(pose.R), pose.R, pose.t, motion.motion.inliers)
    views = further_views(history, pair.reference, pair.current, config.map)
    return build_candidate(camera, config, table_of(pair.reference, pair.current, views), hypothesis, threshold_rad)


def _usable(config: Config, attempt: Attempt, candidate: MapCandidate) -> WindowDecision:
    """Refuse a map that cannot be used, although its motion is right: too few landmarks, or no adjustment."""
    attempt = replace(attempt, frames=(*attempt.frames, *candidate.table.frames[2:]))
    if not isinstance(candidate.bundle, BundleSolution):
        attempt = replace(attempt, map=MapEvidence(failure=candidate.bundle.cause))
        return WindowDecision(refused_at(attempt, Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP))
    attempt = replace(attempt, map=MapEvidence(reprojection_rmse_px=candidate.bundle.rmse_px))
    landmarks = at_least(
        GateName.LANDMARKS,
        len(candidate.bundle.problem.points),
        config.acceptance.min_landmarks,
        Verdict.TOO_FEW_LANDMARKS,
    )
    attempt = with_gates(attempt, (landmarks,))
    if not landmarks.passes():
        return WindowDecision(refused_by(attempt, Stage.MAP, (landmarks,)))
    return WindowDecision(attempt, (candidate,))
