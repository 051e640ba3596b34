"""What an initializer hands over, whatever its method: refusals with a reason, the map, the reason of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from slam_init.bundle_problem import BundleSolution
from slam_init.config import MapConfig
from slam_init.keyframes import PairPreview
from slam_init.online import progress
from slam_init.reasons import ACCEPTED, ADVICE, REASONS, Gate
from slam_init.types import Attempt, InitialMap, Keyframe, Observations

__all__ = [
    "ATTEMPTS_KEPT",
    "AttemptLog",
    "Evidence",
    "focal_notes",
    "initial_map",
    "looked_at",
    "preview_evidence",
    "refusal",
    "refused",
    "refused_at",
    "refused_by",
    "reported_focal_factor",
]

Evidence = dict[str, float | int | str]

_VERDICTS = (*REASONS, ACCEPTED)


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


def looked_at(attempt: Attempt, gates: Sequence[Gate]) -> Attempt:
    """The attempt with more gates, and their values and thresholds as evidence."""
    evidence = dict(attempt.evidence)
    for gate in gates:
        evidence |= gate.evidence()
    return replace(attempt, gates=(*attempt.gates, *gates), evidence=evidence)


def refused_by(attempt: Attempt, stage: str, gates: Sequence[Gate]) -> Attempt:
    """The attempt, refused by the first of these gates that does not pass."""
    failed = next(gate for gate in gates if not gate.passes())
    return replace(attempt, verdict=failed.reason, advice=failed.advice, progress=progress(stage, gates))


def refused_at(attempt: Attempt, reason: str, stage: str) -> Attempt:
    """The attempt, refused for a reason that has no figure."""
    return replace(attempt, verdict=reason, advice=ADVICE[reason], progress=progress(stage))


#: Attempts that are remembered in full: half a minute of video, and all that a recording of that length shows. What is
#: remembered must not grow with the length of the video.
ATTEMPTS_KEPT = 1000

#: A single pair may look like a turning camera by chance. The check finds the factor of one that turns to a hundredth.
_LEAST_SUSPICIONS, _ALIKE = 2, 0.015


class AttemptLog:
    """The attempts of a run: the last ones without their matches, of all of them the verdict in one byte.

    Parameters
    ----------
    limit : int
        How many are kept.
    """

    def __init__(self, limit: int = ATTEMPTS_KEPT) -> None:
        self._kept: deque[Attempt] = deque(maxlen=limit)
        self._verdicts = bytearray()

    def __len__(self) -> int:
        return len(self._verdicts)

    def add(self, attempt: Attempt) -> None:
        """Remember an attempt."""
        none = np.zeros((0, 2))
        self._kept.append(replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool)))
        self._verdicts.append(_VERDICTS.index(attempt.verdict))

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """The last attempts."""
        return tuple(self._kept)

    def prevailing_reason(self) -> str:
        """What the second half of the attempts mostly said; the slow start of a video says little."""
        if not self._verdicts:
            return "too_few_frames"
        counts = Counter(self._verdicts[len(self._verdicts) // 2 :])
        return _VERDICTS[min(counts, key=lambda verdict: (-counts[verdict], verdict))]

    def advice(self, reason: str) -> str:
        """What would help: that of the last attempt that was refused for the reason."""
        return next((a.advice for a in reversed(self._kept) if a.verdict == reason), ADVICE[reason])

    def notes(self) -> tuple[str, ...]:
        """What the user should know: a calibration that most checks suspect, attempts that are not kept."""
        notes = []
        factor = reported_focal_factor(self._kept)
        if factor is not None:
            notes.append(
                f"the matches look like those of a camera that only turned, with a focal length {factor:.2f} times the "
                "stated one: check the calibration"
            )
        if len(self) > len(self._kept):
            notes.append(f"{len(self)} attempts were made; the last {len(self._kept)} are listed")
        return tuple(notes)


def reported_focal_factor(attempts: Iterable[Attempt]) -> float | None:
    """What most checks of the calibration suspect, two at least, and alike: a wrong one is so in every pair.

    Parameters
    ----------
    attempts : iterable of Attempt
        Of a run.

    Returns
    -------
    float or None
        The focal length over the stated one; None where nothing is suspected.
    """
    checked = [a.evidence for a in attempts if "turning_focal_factor" in a.evidence]
    factors = [float(e["suspected_focal_factor"]) for e in checked if "suspected_focal_factor" in e]
    if len(factors) < _LEAST_SUSPICIONS or 2 * len(factors) <= len(checked):
        return None
    factor = float(np.median(factors))
    first, second = np.triu_indices(len(factors), 1)
    alike = np.median(np.abs(np.array(factors)[first] - np.array(factors)[second])) < _ALIKE
    return factor if alike else None


def focal_notes(map_: InitialMap | None, config: MapConfig) -> tuple[str, ...]:
    """What the user should know of an adjusted focal length: that the views did not tell it, where that is so.

    Parameters
    ----------
    map_ : InitialMap or None
    config : MapConfig
        That the map was adjusted with.
    """
    if map_ is None or map_.focal_factor_sigma is None:
        return ()
    # Below this the views know more of it than the prior: two equal variances together are half of one.
    if map_.focal_factor_sigma < config.focal_sigma / np.sqrt(2):
        return ()
    return (
        f"the views do not tell the focal length: {map_.focal_factor:.3f} +- {map_.focal_factor_sigma:.3f} times the "
        f"stated one is little more than the assumption of +- {config.focal_sigma:.3g}; turn the camera while it moves",
    )


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
        camera=bundle.camera,
        focal_factor=bundle.focal_factor,
        focal_factor_sigma=bundle.focal_factor_sigma,
    )
