"""One pair of frames: refused at a glance, or tried: two-view geometry, a map for each motion, the vote, the gates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, NoPose, RelativePose, estimate_relative_pose
from quest.jackknife import direction_spread_rad
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.calibration_check import turning_camera
from slam_init.decision.correlated_error import rounding_error_px, shared_error_rad
from slam_init.decision.pair_rules import (
    judge_map,
    judge_turning,
    judge_two_views,
    suspect_calibration,
    turning_evidence,
    vote,
    vote_of_plane,
)
from slam_init.decision.refusal import Evidence, looked_at, preview_evidence, refused_at, refused_by
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.frontend.tracks import History, common_tracks
from slam_init.mapping.candidate import build_candidate
from slam_init.mapping.map_building import initial_map
from slam_init.mapping.rivals import rank
from slam_init.mapping.views import further_views, table_of
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import ACCEPTED, ADVICE, Gate
from slam_init.types.result import Attempt
from slam_init.types.stopwatch import Stopwatch

__all__ = ["Handover", "Outcome", "screen", "try_pair", "with_calibration_check"]

#: A tenth of the tracks may be mistaken; more of them displaced against the rotation is a motion to look at.
_LEAST_PARALLAX_SHARE = 0.1
#: An outlier threshold of three standard deviations is what is wanted. Where those that are left within it are half of
#: it, it cut off a good part of the right matches (if they filled it evenly it would be three quarters), and it is
#: widened, once: from what a noise of 0.7 px needs to one of 2 px.
_TOO_NOISY_SIGMAS, _WIDER = 2.0, 3.0


@dataclass(frozen=True, eq=False)
class Handover:
    """A map, and the frames that it is made of: at the end of the sequence the history may have forgotten them."""

    map: InitialMap
    views: tuple[Observations, ...]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a pair.

    Attributes
    ----------
    attempt : Attempt
    accepted : Handover or None
        A map that passed all gates.
    unconfirmed : Handover or None
        A map of two views without a rival, which lacks nothing but a third view.
    hypotheses : tuple of InitialMap
        The maps that the vote could not decide between, the better one first.
    margin : Margin or None
        Of the vote, where there were two maps.
    """

    attempt: Attempt
    accepted: Handover | None = None
    unconfirmed: Handover | None = None
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None


# -- at a glance ----------------------------------------------------------------------------------


def screen(camera: Camera, config: Config, current: Observations, pairs: list[PairPreview]) -> Attempt | None:
    """Refuse at a glance what no pair can yield: no tracks, no motion, no parallax; None where there may be some.

    Parameters
    ----------
    camera : Camera
    config : Config
    current : Observations
    pairs : list of PairPreview
        Of all candidates with the current frame, the most promising first.
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
        Gate("features", len(current), needed, True, "too_few_features", ADVICE["too_few_features"]),
        Gate("matches", pair.matches, needed, True, "too_few_matches", ADVICE["too_few_matches"]),
    )
    # Without parallax the camera turned or stood still: a rotation that is fitted to noise turns by next to nothing.
    turned_px = float(np.radians(max((p.rotation_deg for p in usable), default=0.0))) * camera.focal_px
    turned = Gate("turned_px", turned_px, noise_px, True, "static_camera", ADVICE["static_camera"])
    motion = (
        Gate("motion_px", motion_px, noise_px, True, "static_camera", ADVICE["static_camera"]),
        *([turned] if share < _LEAST_PARALLAX_SHARE else []),
        Gate("parallax_share", share, _LEAST_PARALLAX_SHARE, True, "pure_rotation", ADVICE["pure_rotation"]),
    )
    attempt = Attempt((pair.reference, pair.current), ACCEPTED, preview_evidence(pair))
    for stage, gates in (("matches", matches), ("motion", motion)):
        attempt = looked_at(attempt, gates)
        if any(not gate.passes() for gate in gates):
            return refused_by(attempt, stage, gates)
    return None


def with_calibration_check(
    camera: Camera, config: Config, attempt: Attempt, reference: Observations, current: Observations
) -> Attempt:
    """A pair that was refused as a rotation, with what its matches say of the focal length.

    Parameters
    ----------
    camera : Camera
    config : Config
    attempt : Attempt
    reference, current : Observations
        A pair far apart in rotation: the further, the more a wrong focal length shows.
    """
    i, j = common_tracks(reference, current)
    # Where two views were looked at they told the noise.
    noise_px = max(config.map.noise_px, float(attempt.evidence.get("two_view_noise_px", 0.0)))
    noise_rad = noise_px / camera.focal_px
    shared_rad = config.acceptance.min_shared_error_px / camera.focal_px
    turning = turning_camera(reference.bearings[i], current.bearings[j], noise_rad)
    evidence = turning_evidence(camera, config, turning, noise_rad, shared_rad)
    return replace(attempt, evidence=attempt.evidence | evidence)


# -- the whole way --------------------------------------------------------------------------------


def try_pair(
    camera: Camera,
    config: Config,
    history: History,
    pair: PairPreview,
    current: Observations,
    stopwatch: Stopwatch,
    *,
    third_view: bool = True,
) -> Outcome:
    """Two-view geometry, a map for each hypothesis, the vote, the gates.

    Parameters
    ----------
    camera : Camera
    config : Config
    history : History
        Holds the reference frame and what may vote.
    pair : PairPreview
    current : Observations
    stopwatch : Stopwatch
        Times the stages ``two_view`` and ``map``.
    third_view : bool
        Whether further views decide and confirm; without them the better two-view map is taken.
    """
    reference = history[pair.reference]
    i, j = common_tracks(reference, current)
    m, n = reference.bearings[i], current.bearings[j]
    with stopwatch("two_view"):
        threshold_rad = config.two_view.threshold_px / camera.focal_px
        pose = estimate_relative_pose(m, n, threshold_rad=threshold_rad, seed=config.seed)
        if isinstance(pose, RelativePose) and pose.noise_rad > threshold_rad / _TOO_NOISY_SIGMAS:
            wider_rad = min(_WIDER * threshold_rad, 1.0)
            again = estimate_relative_pose(m, n, threshold_rad=wider_rad, seed=config.seed)
            if isinstance(again, RelativePose) and again.kind != "rotation":
                pose, threshold_rad = again, wider_rad
    attempt = Attempt(
        frames=(pair.reference, pair.current),
        verdict=ACCEPTED,
        evidence=preview_evidence(pair) | _pose_evidence(pose, camera),
        pixels1=reference.pixels[i],
        pixels2=current.pixels[j],
        inliers=pose.inliers if isinstance(pose, RelativePose) else np.zeros(len(i), bool),
    )
    if isinstance(pose, NoPose):
        return Outcome(refused_at(attempt, pose.reason, "two views"))
    with stopwatch("two_view"):
        turning = turning_camera(m[pose.inliers], n[pose.inliers], pose.noise_rad)
        rounding_px = rounding_error_px(current.pixels[j])
        shared_rad = max(config.acceptance.min_shared_error_px, rounding_px) / camera.focal_px
        spread_rad = 0.0
        if pose.kind != "rotation":
            shared_rad = max(shared_rad, shared_error_rad(pose, m, n, reference.pixels[i]))
            spread_rad = direction_spread_rad(pose, m, n)
    attempt = replace(attempt, evidence=attempt.evidence | {"shared_error_px": shared_rad * camera.focal_px})
    # An error that tracks share turns the baseline by its ratio to what no rotation explains, however many tracks there
    # are: before a plane that is far less than the parallax.
    shared_turn_rad = float(np.arctan2(shared_rad, turning.off_rotation_rad(pose.noise_rad)))
    attempt = judge_two_views(camera, config, attempt, pose, shared_turn_rad, spread_rad)
    if attempt.verdict != ACCEPTED:
        if attempt.verdict == "low_parallax":
            attempt = suspect_calibration(camera, config, attempt, pose, turning, shared_rad)
        return Outcome(attempt)

    with stopwatch("map"):
        views = further_views(history, reference, current, config.map) if third_view else []
        table = table_of(reference, current, views)
        hypotheses: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
        candidates = [build_candidate(camera, config, table, h, threshold_rad) for h in hypotheses]
        candidates = rank(camera, config, candidates)
        plane = vote_of_plane(config, history, reference, current, pose, candidates) if third_view else None
        if plane is not None and plane.reversed().decides():
            candidates[:2] = candidates[1::-1]
            plane = plane.reversed()
    attempt = replace(attempt, frames=(*attempt.frames, *table.frames[2:]))
    best = candidates[0]
    if not isinstance(best.bundle, BundleSolution):
        attempt = replace(attempt, evidence=attempt.evidence | {"cause": best.bundle.cause})
        return Outcome(refused_at(attempt, "bundle_adjustment_failed", "map"))

    attempt, ruling = vote(camera, config, attempt, candidates if third_view else candidates[:1], plane)
    if attempt.verdict != ACCEPTED:
        suspected = suspect_calibration(camera, config, attempt, pose, turning, shared_rad)
        # A turning camera is a third explanation then, and the two maps are no kept set.
        kept = (best, ruling.rival) if suspected.verdict == attempt.verdict else ()
        undecided = tuple(
            _hand_over(history, one.bundle, pose.kind).map
            for one in kept
            if one is not None and isinstance(one.bundle, BundleSolution)
        )
        return Outcome(suspected, hypotheses=undecided, margin=ruling.margin)

    attempt = judge_map(camera, config, attempt, best, best.bundle, shared_turn_rad, ruling.near_deg, third_view)
    confirmable = attempt.verdict == "no_third_view" and len(table.frames) == 2 and len(candidates) == 1
    if attempt.verdict != ACCEPTED and not confirmable:
        return Outcome(attempt, margin=ruling.margin)
    noise_rad = best.bundle.noise_px / camera.focal_px
    attempt = judge_turning(camera, config, attempt, turning, noise_rad, shared_rad)
    handover = _hand_over(history, best.bundle, pose.kind)
    if attempt.verdict == ACCEPTED:
        return Outcome(replace(attempt, progress=1.0), accepted=handover, margin=ruling.margin)
    return Outcome(attempt, unconfirmed=handover if attempt.verdict == "no_third_view" else None, margin=ruling.margin)


def _hand_over(history: History, bundle: BundleSolution, scene: str) -> Handover:
    views = tuple(history[frame] for frame in bundle.problem.frames)
    return Handover(initial_map(bundle, views, scene), views)


def _pose_evidence(pose: RelativePose | NoPose, camera: Camera) -> Evidence:
    evidence: Evidence = {f"two_view_{name}": value for name, value in pose.evidence.items() if name != "noise_rad"}
    if isinstance(pose, RelativePose):
        evidence |= {
            "two_view_kind": pose.kind,
            "two_view_alternatives": len(pose.alternatives),
            "two_view_noise_px": pose.noise_rad * camera.focal_px,
            "two_view_parallax_deg": float(np.degrees(pose.parallax_rad)),
            "two_view_direction_sigma_deg": float(np.degrees(pose.direction_sigma_rad)),
        }
    return evidence
