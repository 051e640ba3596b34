"""What an initializer hands over, whatever its method: refusals with a reason, the map, the reason of a whole run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam_init.bundle import BundleSolution
from slam_init.keyframes import PairPreview
from slam_init.reasons import ADVICE, REASONS
from slam_init.types import Attempt, InitialMap, Keyframe, Observations

__all__ = [
    "Evidence",
    "initial_map",
    "prevailing_reason",
    "preview_evidence",
    "refusal",
    "refused",
    "without_matches",
]

Evidence = dict[str, float | int | str]


def refusal(frames: tuple[int, ...], verdict: str, evidence: Evidence) -> Attempt:
    """An attempt that was refused before any matches were looked at."""
    return Attempt(frames, verdict, evidence, ADVICE[verdict])


def refused(attempt: Attempt, verdict: str, evidence: Evidence | None = None) -> Attempt:
    """The attempt, refused for a reason, with the evidence added."""
    return replace(attempt, verdict=verdict, advice=ADVICE[verdict], evidence=attempt.evidence | (evidence or {}))


def preview_evidence(pair: PairPreview) -> Evidence:
    """What the keyframe manager knew of the pair."""
    return {
        "matches": pair.matches,
        "motion_px": pair.motion_px,
        "rotation_deg": pair.rotation_deg,
        "parallax_px": pair.parallax_px,
        "parallax_share": pair.parallax_share,
        "spread": pair.spread,
    }


def without_matches(attempt: Attempt) -> Attempt:
    """The attempt to remember: memory must not grow with the length of the video by megabytes."""
    none = np.zeros((0, 2))
    return replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool))


def prevailing_reason(attempts: Sequence[Attempt]) -> str:
    """What the second half of the attempts mostly said; the slow start of a video says little."""
    if not attempts:
        return "too_few_frames"
    verdicts = Counter(attempt.verdict for attempt in attempts[len(attempts) // 2 :])
    return min(verdicts, key=lambda verdict: (-verdicts[verdict], REASONS.index(verdict)))


def initial_map(bundle: BundleSolution, views: Sequence[Observations], scene: str) -> InitialMap:
    """The map of an adjusted bundle.

    Parameters
    ----------
    bundle : BundleSolution
    views : sequence of Observations
        Of the frames of the bundle, in its order.
    scene : str
        ``general`` or ``planar``.
    """
    problem = bundle.problem
    colors = np.full((len(problem.points), 3), 128, np.uint8)
    for view in views:
        _, at, of = np.intersect1d(problem.track_ids, view.track_ids, return_indices=True)
        if len(view.colors):
            colors[at] = view.colors[of]
    return InitialMap(
        keyframes=tuple(
            Keyframe(view.frame, view.timestamp_s, view.name, pose)
            for view, pose in zip(views, problem.world_from_cam, strict=True)
        ),
        points=problem.points,
        track_ids=problem.track_ids,
        observation_keyframes=problem.views,
        observation_landmarks=problem.landmarks,
        observation_pixels=problem.pixels,
        colors=colors,
        pose_covariances=bundle.pose_covariances,
        gauge=bundle.gauge,
        graph=bundle.graph,
        values=bundle.values,
        points_before=bundle.before.points,
        keyframes_before=bundle.before.world_from_cam,
        bundle_errors=bundle.errors,
        reprojection_rmse_px=bundle.rmse_px,
        median_parallax_deg=float(np.degrees(np.median(problem.parallax_rad()))),
        noise_px=bundle.noise_px,
        scene=scene,
    )
