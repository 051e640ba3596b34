"""One pair of frames, from its preview to its verdict, as a list of stages.

==========================  =========================================================================================
stage                       what it does
==========================  =========================================================================================
``screen``                  refuses all pairs of a frame by their previews: no tracks, no motion, no parallax
                            (:mod:`slam_init.decision.screening`)
:func:`match_pair`          gathers the tracks that both views see
:func:`estimate_two_views`  estimates the relative pose with its alternatives, and the bounds of its direction error
``judge_two_views``         refuses the pair by these bounds (:mod:`slam_init.decision.two_views`)
:func:`build_maps`          builds a bundle-adjusted map for each hypothesis, the best first
``vote_on_rivals``          decides whether the best map beats its rivals (:mod:`slam_init.decision.rival_vote`)
``judge_map``               refuses the map by its gates (:mod:`slam_init.decision.map_gates`)
``judge_rotation_only``     refuses the map where a rotation-only camera explains the matches as well
                            (:mod:`slam_init.decision.rotation_only`)
==========================  =========================================================================================

:func:`try_pair` runs all stages but the first, up to the stage that refuses the pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, NoPose, RelativePose
from quest.jackknife import direction_spread_rad
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.correlated_error import correlated_error_rad, rounding_error_px
from slam_init.decision.map_gates import judge_map
from slam_init.decision.outcome import Outcome
from slam_init.decision.refusal import refused_at, refused_by, with_gates
from slam_init.decision.rival_vote import VoteOutcome, vote_gates, vote_of_plane, vote_on_rivals
from slam_init.decision.rotation_only import fit_rotation_only, judge_rotation_only, suspect_calibration
from slam_init.decision.screening import preview_evidence
from slam_init.decision.two_views import (
    MatchedPair,
    TwoViewEstimate,
    judge_two_views,
    match_pair,
    pose_at_fitting_threshold,
    two_view_evidence,
)
from slam_init.frontend.keyframes import PairPreview
from slam_init.frontend.tracks import History
from slam_init.mapping.candidate import MapCandidate, build_candidate
from slam_init.mapping.map_building import map_with_views
from slam_init.mapping.rivals import rank
from slam_init.mapping.views import TrackTable, further_views, table_of
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.evidence import MapEvidence
from slam_init.types.frame import Observations
from slam_init.types.gates import Stage
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt
from slam_init.types.stopwatch import Stopwatch

__all__ = [
    "MapsOfPair",
    "MatchedPair",
    "Outcome",
    "build_maps",
    "estimate_two_views",
    "match_pair",
    "try_pair",
]


@dataclass(frozen=True, eq=False)
class MapsOfPair:
    """The maps of all hypotheses of a pair.

    Attributes
    ----------
    table : TrackTable
        The tracks of the pair in all views.
    candidates : tuple of MapCandidate
        The best first; those whose adjustment failed last.
    plane : Margin or None
        How much better the first candidate is than the second one, with the plane as a constraint; None where there is
        no such vote.
    """

    table: TrackTable
    candidates: tuple[MapCandidate, ...]
    plane: Margin | None


def try_pair(
    camera: Camera,
    config: Config,
    history: History,
    preview: PairPreview,
    current: Observations,
    stopwatch: Stopwatch,
    *,
    third_view: bool = True,
) -> Outcome:
    """Run the stages of an attempt on a pair: two views, a map for each hypothesis, the vote, the gates.

    Parameters
    ----------
    camera : Camera
    config : Config
    history : History
        Holds the reference frame and the further views.
    preview : PairPreview
        The pair.
    current : Observations
        The current frame.
    stopwatch : Stopwatch
        Times the stages ``two_view`` and ``map``.
    third_view : bool
        Whether further views vote on the maps and confirm the best one. Without them the better two-view map is taken.

    Returns
    -------
    Outcome
    """
    pair = match_pair(history, preview, current)
    with stopwatch("two_view"):
        estimate = estimate_two_views(camera, config, pair)
    attempt = _attempt_of(camera, pair, estimate)
    if isinstance(estimate, NoPose):
        return Outcome(refused_at(attempt, Verdict(estimate.reason), Stage.TWO_VIEWS))
    attempt = judge_two_views(camera, config, attempt, estimate)
    if attempt.verdict == Verdict.LOW_PARALLAX:
        return Outcome(_suspecting_calibration(camera, config, attempt, estimate))
    if attempt.verdict != Verdict.ACCEPTED:
        return Outcome(attempt)
    with stopwatch("map"):
        maps = build_maps(camera, config, history, pair, estimate, third_view=third_view)
    attempt = replace(attempt, frames=(*attempt.frames, *maps.table.frames[2:]))
    best = maps.candidates[0]
    if not isinstance(best.bundle, BundleSolution):
        attempt = replace(attempt, map=MapEvidence(failure=best.bundle.cause))
        return Outcome(refused_at(attempt, Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP))
    vote = vote_on_rivals(camera, maps.candidates if third_view else maps.candidates[:1], maps.plane)
    attempt = replace(attempt, vote=vote.evidence)
    if (deciding := vote.evidence.deciding) is not None:
        attempt = with_gates(attempt, vote_gates(deciding))
        if not deciding.decides():
            attempt = refused_by(attempt, Stage.MAP, vote_gates(deciding))
            return _undecided(camera, config, history, attempt, estimate, best, vote)
    return _judged(camera, config, history, attempt, estimate, maps, best.bundle, vote, third_view=third_view)


def estimate_two_views(camera: Camera, config: Config, pair: MatchedPair) -> TwoViewEstimate | NoPose:
    """Estimate the relative pose of a pair, and the bounds of the error of its direction.

    Parameters
    ----------
    camera : Camera
    config : Config
    pair : MatchedPair

    Returns
    -------
    TwoViewEstimate or NoPose
    """
    rays1, rays2 = pair.rays1, pair.rays2
    pose, threshold_rad = pose_at_fitting_threshold(camera, config, pair)
    if isinstance(pose, NoPose):
        return pose
    rotation_only = fit_rotation_only(rays1[pose.inliers], rays2[pose.inliers], pose.noise_rad)
    least_px = max(config.acceptance.min_correlated_error_px, rounding_error_px(pair.pixels2))
    correlated_rad, jackknife_rad = least_px / camera.focal_px, 0.0
    if pose.kind != "rotation":
        correlated_rad = max(correlated_rad, correlated_error_rad(pose, rays1, rays2, pair.pixels1))
        jackknife_rad = direction_spread_rad(pose, rays1, rays2)
    return TwoViewEstimate(
        pose=pose,
        threshold_rad=threshold_rad,
        rotation_only=rotation_only,
        correlated_rad=correlated_rad,
        # The correlated error turns the baseline by its ratio to the displacement that no rotation explains. More
        # tracks do not lower this angle. On a plane this displacement is far smaller than the parallax.
        correlated_turn_rad=float(np.arctan2(correlated_rad, rotation_only.off_rotation_rad(pose.noise_rad))),
        jackknife_rad=jackknife_rad,
    )


def build_maps(
    camera: Camera,
    config: Config,
    history: History,
    pair: MatchedPair,
    estimate: TwoViewEstimate,
    *,
    third_view: bool = True,
) -> MapsOfPair:
    """Carry each hypothesis of a pair to a bundle-adjusted map, and rank the maps.

    Parameters
    ----------
    camera : Camera
    config : Config
    history : History
        Holds the further views.
    pair : MatchedPair
    estimate : TwoViewEstimate
        Its pose and the alternatives of the pose are the hypotheses.
    third_view : bool
        Whether further views take part.

    Returns
    -------
    MapsOfPair
    """
    reference, current, pose = pair.reference, pair.current, estimate.pose
    views = further_views(history, reference, current, config.map) if third_view else []
    table = table_of(reference, current, views)
    hypotheses: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    candidates = [build_candidate(camera, config, table, h, estimate.threshold_rad) for h in hypotheses]
    candidates = rank(camera, candidates)
    plane = vote_of_plane(config, history, reference, current, pose, candidates) if third_view else None
    if plane is not None and plane.reversed().decides():
        candidates[:2] = candidates[1::-1]
        plane = plane.reversed()
    return MapsOfPair(table, tuple(candidates), plane)


# -- parts of the stages --------------------------------------------------------------------------


def _attempt_of(camera: Camera, pair: MatchedPair, estimate: TwoViewEstimate | NoPose) -> Attempt:
    """Return the attempt with the evidence of the preview and of the two views, before any verdict."""
    pose = estimate.pose if isinstance(estimate, TwoViewEstimate) else None
    return Attempt(
        frames=(pair.preview.reference, pair.preview.current),
        verdict=Verdict.ACCEPTED,
        pixels1=pair.pixels1,
        pixels2=pair.pixels2,
        inliers=np.zeros(len(pair.rays1), bool) if pose is None else pose.inliers,
        preview=preview_evidence(pair.preview),
        two_view=two_view_evidence(camera, estimate),
    )


def _suspecting_calibration(camera: Camera, config: Config, attempt: Attempt, estimate: TwoViewEstimate) -> Attempt:
    return suspect_calibration(camera, config, attempt, estimate.pose, estimate.rotation_only, estimate.correlated_rad)


def _undecided(
    camera: Camera,
    config: Config,
    history: History,
    attempt: Attempt,
    estimate: TwoViewEstimate,
    best: MapCandidate,
    vote: VoteOutcome,
) -> Outcome:
    """Return two maps that the tracks do not decide between, or none where a rotation-only camera is suspected."""
    suspected = _suspecting_calibration(camera, config, attempt, estimate)
    # A suspected rotation-only camera is a third explanation: then both maps may be wrong, and neither is kept.
    kept = (best, vote.nearest) if suspected.verdict == attempt.verdict else ()
    undecided = tuple(
        map_with_views(history, one.bundle, estimate.pose.kind).map
        for one in kept
        if one is not None and isinstance(one.bundle, BundleSolution)
    )
    return Outcome(suspected, hypotheses=undecided, margin=vote.evidence.deciding)


def _judged(
    camera: Camera,
    config: Config,
    history: History,
    attempt: Attempt,
    estimate: TwoViewEstimate,
    maps: MapsOfPair,
    bundle: BundleSolution,
    vote: VoteOutcome,
    *,
    third_view: bool,
) -> Outcome:
    """Judge the best map by its gates. If it passes, or lacks only a third view, judge the rotation-only rival too."""
    margin = vote.evidence.deciding
    attempt = judge_map(
        camera,
        attempt,
        maps.candidates[0],
        bundle,
        estimate.correlated_turn_rad,
        vote.evidence.near_rival_deg,
        config.acceptance,
        third_view=third_view,
    )
    two_views_without_rival = len(maps.table.frames) == 2 and len(maps.candidates) == 1
    confirmable = attempt.verdict == Verdict.NO_THIRD_VIEW and two_views_without_rival
    if attempt.verdict != Verdict.ACCEPTED and not confirmable:
        return Outcome(attempt, margin=margin)
    noise_rad = bundle.noise_px / camera.focal_px
    attempt = judge_rotation_only(camera, config, attempt, estimate.rotation_only, noise_rad, estimate.correlated_rad)
    built = map_with_views(history, bundle, estimate.pose.kind)
    if attempt.verdict == Verdict.ACCEPTED:
        return Outcome(replace(attempt, progress=1.0), accepted=built, margin=margin)
    return Outcome(attempt, unconfirmed=built if attempt.verdict == Verdict.NO_THIRD_VIEW else None, margin=margin)
