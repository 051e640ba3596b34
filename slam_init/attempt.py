"""One pair of frames, from its preview to its verdict, as a list of stages.

====================================  ==========================================================================
stage                                 what it does
====================================  ==========================================================================
:func:`screen`                        refuses all pairs of a frame by their previews: no tracks, no motion, no
                                      parallax
:func:`match_pair`                    the tracks that both views see
:func:`estimate_two_views`            relative pose with its alternatives, and what bounds the direction error
:func:`judge_two_views`               refuses the pair by these bounds (:mod:`slam_init.decision.two_views`)
:func:`build_maps`                    a bundle-adjusted map for each hypothesis, the best first
:func:`vote_on_rivals`                whether the best map beats its rivals (:mod:`slam_init.decision.rival_vote`)
:func:`judge_map`                     the gates of the map (:mod:`slam_init.decision.map_gates`)
:func:`judge_rotation_only`           whether a rotation-only camera explains the matches as well
                                      (:mod:`slam_init.decision.rotation_only`)
====================================  ==========================================================================

:func:`try_pair` runs all but the first one, up to the stage that refuses the pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, NoPose, RelativePose, estimate_relative_pose
from quest.jackknife import direction_spread_rad
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.correlated_error import correlated_error_rad, rounding_error_px
from slam_init.decision.map_gates import judge_map
from slam_init.decision.refusal import refused_at, refused_by, with_gates
from slam_init.decision.rival_vote import VoteOutcome, vote_gates, vote_of_plane, vote_on_rivals
from slam_init.decision.rotation_only import fit_rotation_only, judge_rotation_only, suspect_calibration
from slam_init.decision.two_views import TwoViewEstimate, judge_two_views
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.frontend.tracks import History, common_tracks
from slam_init.mapping.candidate import MapCandidate, build_candidate
from slam_init.mapping.map_building import MapWithViews, map_with_views
from slam_init.mapping.rivals import rank
from slam_init.mapping.views import TrackTable, further_views, table_of
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.evidence import MapEvidence, PreviewEvidence, TwoViewEvidence
from slam_init.types.frame import Observations
from slam_init.types.gates import GateName, Stage, at_least
from slam_init.types.initial_map import InitialMap
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
    "screen",
    "try_pair",
]

#: A tenth of the tracks may be outliers; if more are displaced against the rotation, the pair is worth a closer look.
_LEAST_PARALLAX_SHARE = 0.1
#: The outlier threshold should be three standard deviations of the noise. Where the noise of the inliers is half of the
#: threshold, the threshold cut off a good part of the correct matches (if they filled it evenly, their deviation would
#: be 0.58 of it), and is widened once: from what a noise of 0.7 px needs to what 2 px need.
_TOO_NOISY_SIGMAS, _WIDER = 2.0, 3.0


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The tracks that both views of a pair see.

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


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a pair.

    Attributes
    ----------
    attempt : Attempt
        The verdict and its evidence.
    accepted : MapWithViews or None
        A map that passed all gates.
    unconfirmed : MapWithViews or None
        A map of two views without a rival, to which nothing is missing but a third view.
    hypotheses : tuple of InitialMap
        The maps that the vote could not decide between, the better one first.
    margin : Margin or None
        The deciding vote, where there were two maps.
    """

    attempt: Attempt
    accepted: MapWithViews | None = None
    unconfirmed: MapWithViews | None = None
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None


def screen(camera: Camera, config: Config, current: Observations, pairs: Sequence[PairPreview]) -> Attempt | None:
    """Refuse all pairs of a frame at once where no pair can lead to a map.

    Parameters
    ----------
    camera : Camera
    config : Config
    current : Observations
        The current frame.
    pairs : sequence of PairPreview
        Of all candidate references with the current frame, the highest direction score first.

    Returns
    -------
    Attempt or None
        A refusal for lack of tracks, motion or parallax; None where a pair is worth trying, or there is no pair.
    """
    if not pairs:
        return None
    needed = config.keyframes.min_matches
    usable = [pair for pair in pairs if pair.matches >= needed]
    pair = (usable or pairs)[0]
    motion_px = max((p.motion_px for p in usable), default=0.0)
    share = max((p.parallax_share for p in usable), default=0.0)
    noise_px = difference_gate(config.map.noise_px)
    matches = (
        at_least(GateName.FEATURES, len(current), needed, Verdict.TOO_FEW_FEATURES),
        at_least(GateName.MATCHES, pair.matches, needed, Verdict.TOO_FEW_MATCHES),
    )
    # Without parallax the camera only rotated, or was static: a rotation that is fitted to noise is close to zero.
    rotation_px = float(np.radians(max((p.rotation_deg for p in usable), default=0.0))) * camera.focal_px
    rotation = at_least(GateName.ROTATION_PX, rotation_px, noise_px, Verdict.STATIC_CAMERA)
    motion = (
        at_least(GateName.MOTION_PX, motion_px, noise_px, Verdict.STATIC_CAMERA),
        *([rotation] if share < _LEAST_PARALLAX_SHARE else []),
        at_least(GateName.PARALLAX_SHARE, share, _LEAST_PARALLAX_SHARE, Verdict.PURE_ROTATION),
    )
    attempt = Attempt((pair.reference, pair.current), Verdict.ACCEPTED, preview=_preview_evidence(pair))
    for stage, gates in ((Stage.MATCHES, matches), (Stage.MOTION, motion)):
        attempt = with_gates(attempt, gates)
        if any(not gate.passes() for gate in gates):
            return refused_by(attempt, stage, gates)
    return None


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
    """Two views, a map for each hypothesis, the vote, the gates.

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
        Whether further views decide and confirm. Without them the better two-view map is taken.

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
    vote = vote_on_rivals(camera, config, maps.candidates if third_view else maps.candidates[:1], maps.plane)
    attempt = replace(attempt, vote=vote.evidence)
    deciding = vote.evidence.deciding
    if deciding is not None:
        gates = vote_gates(deciding)
        attempt = with_gates(attempt, gates)
        if not deciding.decides():
            attempt = refused_by(attempt, Stage.MAP, gates)
            return _undecided(camera, config, history, attempt, estimate, best, vote)
    return _judged(camera, config, history, attempt, estimate, maps, best.bundle, vote, third_view=third_view)


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


def estimate_two_views(camera: Camera, config: Config, pair: MatchedPair) -> TwoViewEstimate | NoPose:
    """Estimate the relative pose of a pair, and what bounds the error of its direction.

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
    pose, threshold_rad = _pose_at_fitting_threshold(camera, config, pair)
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
        # The correlated error turns the baseline by its ratio to the displacement that no rotation explains, however
        # many tracks there are. On a plane this displacement is far smaller than the parallax.
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
    candidates = rank(camera, config, candidates)
    plane = vote_of_plane(config, history, reference, current, pose, candidates) if third_view else None
    if plane is not None and plane.reversed().decides():
        candidates[:2] = candidates[1::-1]
        plane = plane.reversed()
    return MapsOfPair(table, tuple(candidates), plane)


# -- parts of the stages --------------------------------------------------------------------------


def _pose_at_fitting_threshold(
    camera: Camera, config: Config, pair: MatchedPair
) -> tuple[RelativePose | NoPose, float]:
    """The relative pose and its outlier threshold in radians, which is widened once for noisy tracks."""
    threshold_rad = config.two_view.threshold_px / camera.focal_px
    pose = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=threshold_rad, seed=config.seed)
    if isinstance(pose, RelativePose) and pose.noise_rad > threshold_rad / _TOO_NOISY_SIGMAS:
        wider_rad = min(_WIDER * threshold_rad, 1.0)
        again = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=wider_rad, seed=config.seed)
        if isinstance(again, RelativePose) and again.kind != "rotation":
            return again, wider_rad
    return pose, threshold_rad


def _attempt_of(camera: Camera, pair: MatchedPair, estimate: TwoViewEstimate | NoPose) -> Attempt:
    """The attempt with the evidence of the preview and of the two views, before any verdict."""
    pose = estimate.pose if isinstance(estimate, TwoViewEstimate) else None
    return Attempt(
        frames=(pair.preview.reference, pair.preview.current),
        verdict=Verdict.ACCEPTED,
        pixels1=pair.pixels1,
        pixels2=pair.pixels2,
        inliers=np.zeros(len(pair.rays1), bool) if pose is None else pose.inliers,
        preview=_preview_evidence(pair.preview),
        two_view=_two_view_evidence(camera, estimate),
    )


def _preview_evidence(pair: PairPreview) -> PreviewEvidence:
    return PreviewEvidence(
        matches=pair.matches,
        motion_px=pair.motion_px,
        rotation_deg=pair.rotation_deg,
        parallax_px=pair.parallax_px,
        parallax_share=pair.parallax_share,
        spread=pair.spread,
    )


def _two_view_evidence(camera: Camera, estimate: TwoViewEstimate | NoPose) -> TwoViewEvidence:
    if isinstance(estimate, NoPose):
        return TwoViewEvidence(estimate.evidence)
    pose = estimate.pose
    return TwoViewEvidence(
        statistics=pose.evidence,
        kind=pose.kind,
        alternatives=len(pose.alternatives),
        noise_px=pose.noise_rad * camera.focal_px,
        parallax_deg=float(np.degrees(pose.parallax_rad)),
        direction_sigma_deg=float(np.degrees(pose.direction_sigma_rad)),
        correlated_error_px=estimate.correlated_rad * camera.focal_px,
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
    """Two maps that the tracks do not decide between; neither is kept where a rotation-only camera is suspected."""
    suspected = _suspecting_calibration(camera, config, attempt, estimate)
    # The rotation-only camera is a third explanation then, and one of the two maps need not be right.
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
    """The best map with the verdict of its gates, and of the rotation-only rival where the gates leave a map."""
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
