"""The result of an attempt, and the result of a run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from quest.display import Described
from slam_init.errors import plain_line
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.evidence import (
    FreeEvidence,
    FreeFocal,
    MapEvidence,
    Margin,
    PreviewEvidence,
    TwoViewEvidence,
    WindowEvidence,
)
from slam_init.types.initial_map import InitialMap, Keyframe, Savable, risk_in_words
from slam_init.types.refusal import Gate, Stage, Verdict, in_words, progress
from slam_init.types.scale import Scale
from slam_init.types.stopwatch import StageTimes


@dataclass(frozen=True, eq=False, repr=False)
class Attempt(Described):
    """One attempt to initialize from a pair of frames, and its verdict.

    Attributes
    ----------
    frames : tuple of int
        Absolute indices of the pair (reference, current), then of the further keyframes of its map.
    verdict : Verdict
        ``accepted`` or the reason of the refusal.
    advice : str
        What the person who moves the camera should do, in a few words: the advice of the gate that failed; empty when
        accepted.
    gates : tuple of Gate
        The conditions that were evaluated, up to the stage that refused the pair.
    stage : Stage or None
        The stage that refused the pair; None if it was accepted, or refused by the rules of another method.
    progress : float
        How far the pair advanced through the stages, 0 to 1: see :func:`slam_init.types.refusal.progress`.
    pixels1, pixels2 : (N, 2) float
        The matches of the pair, raw pixels.
    inliers : (N,) bool
        Which of the matches the best model explains.
    moving : (N,) bool
        Which of the matches lie on objects with a rigid motion of their own; empty where it was not looked for.
    preview : PreviewEvidence or None
        Figures before any epipolar geometry; None for the rules of another method.
    two_view : TwoViewEvidence or None
        Figures of the relative pose; None if the pair was refused before.
    free_focal : FreeFocal or None
        The focal length by the tracks alone, where it was fitted; ``contradicts`` says whether it contradicts the
        stated one.
    window : WindowEvidence or None
        Figures of the joint estimate of all views; None if no motion was known, and for the rules of another method.
    map : MapEvidence or None
        Figures of bundle adjustment; None if no map was built.
    method_evidence : mapping of str to float, int or str
        Figures of a third-party method, under its own names; empty for ``quest``.
    """

    frames: tuple[int, ...]
    verdict: Verdict
    advice: str = ""
    gates: tuple[Gate, ...] = ()
    stage: Stage | None = None
    progress: float = 0.0
    pixels1: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    pixels2: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    inliers: Bools = field(default_factory=lambda: np.zeros(0, bool))
    moving: Bools = field(default_factory=lambda: np.zeros(0, bool))
    preview: PreviewEvidence | None = None
    two_view: TwoViewEvidence | None = None
    free_focal: FreeFocal | None = None
    window: WindowEvidence | None = None
    map: MapEvidence | None = None
    method_evidence: FreeEvidence = field(default_factory=dict)

    @property
    def failed_gates(self) -> tuple[Gate, ...]:
        """The gates that did not pass."""
        return tuple(gate for gate in self.gates if not gate.passes())

    @property
    def evaluated(self) -> bool:
        """Whether a motion was estimated from the matches, so that they are inliers and outliers of it."""
        estimated = (self.two_view, self.window, self.map)
        return bool(self.inliers.any() or self.method_evidence or any(part is not None for part in estimated))

    @property
    def suspected_focal_factor(self) -> float | None:
        """The suspected true focal length divided by the stated one; None if the stated one is not suspected."""
        free = self.free_focal
        return free.factor if free is not None and free.contradicts else None

    def with_gates(self, gates: Sequence[Gate]) -> Attempt:
        """The attempt with further gates."""
        return replace(self, gates=(*self.gates, *gates))

    def refused_by(self, stage: Stage, gates: Sequence[Gate]) -> Attempt:
        """The attempt refused for the reason of the first gate that does not pass."""
        failed = next(gate for gate in gates if not gate.passes())
        reached = progress(stage, gates)
        return replace(self, verdict=failed.reason, advice=failed.advice, stage=stage, progress=reached)

    def refused_at(self, reason: Verdict, stage: Stage | None = None) -> Attempt:
        """The attempt refused for a reason that has no gate; the rules of other systems have no stages."""
        reached = 0.0 if stage is None else progress(stage)
        return replace(self, verdict=reason, advice=reason.advice, stage=stage, progress=reached)

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        facts = [("advice", self.advice)] if self.advice else []
        facts.append(("gates", f"{len(self.gates) - len(self.failed_gates)} of {len(self.gates)} pass"))
        facts += [("failed", str(gate)) for gate in self.failed_gates[:2]]
        if self.two_view is not None and self.two_view.kind is not None:
            facts.append(("two views", f"{self.two_view.kind}, {self.two_view.alternatives} alternatives"))
        return f"frames {', '.join(map(str, self.frames))}: {self.verdict}", facts


@dataclass(frozen=True)
class GroundTruthErrors:
    """Errors of the keyframes of a map against the true trajectory."""

    #: Angle between the estimated and the true rotation relative to the first keyframe; largest value over the
    #: keyframes.
    rotation_error_deg: float
    #: Angle between the estimated and the true translation relative to the first keyframe, in the frame of the first
    #: camera; largest value over the keyframes. Keyframes whose true baseline is shorter than 0.3 of the longest one
    #: are left out. A keyframe that is estimated exactly at the first one has no direction and counts as 180. None if
    #: the true camera is static.
    direction_error_deg: float | None
    #: Root mean square position error of the keyframes after alignment by a similarity, in units of the ground truth;
    #: None if the true camera is static, and for two keyframes, which a similarity aligns exactly.
    ate_rmse: float | None
    #: Length of the true path from the first keyframe to the last, in units of the ground truth.
    path_length: float
    #: Lengths of a map in metres over the true ones, minus 1, by the keyframes and the frames that were located after
    #: the initialization. None for a map without a scale, and where the scale is that of the ground truth.
    scale_error: float | None = None
    #: Standard deviation of the true direction of the keyframe with the largest error, by the accuracy of the true
    #: positions over its baseline; 0 where nothing states that they are measured. None if the true camera is static.
    true_direction_sigma_deg: float | None = None
    #: The true baseline of that keyframe, in units of the ground truth.
    true_baseline: float | None = None


@dataclass(frozen=True, eq=False)
class ProvisionalMap:
    """The map of the window that was evaluated last, of an initializer that has not accepted one yet.

    Attributes
    ----------
    map : InitialMap
    """

    map: InitialMap

    @property
    def risk(self) -> float:
        """Probability that the map is wrong: a rotation off by 5 degrees, or a baseline by 15 degrees."""
        assert self.map.risk is not None
        return self.map.risk


#: Largest number of maps of a run that restarts after a loss: a map takes some megabytes of memory.
MAX_SEGMENTS = 99


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of the frames with a map of its own. A new one begins where the map of the one before was lost."""

    #: Its world frame is the camera frame of its own first keyframe.
    map: InitialMap
    #: Absolute index of the first frame.
    first_frame: int
    #: Number of frames from there until the map was accepted.
    frames_to_init: int
    #: The frames after the initialization that were located in the map.
    located: tuple[Keyframe, ...] = ()
    #: Absolute index of the first frame that could not be located any more; None where the frames ended before, or were
    #: not followed.
    lost_at: int | None = None
    #: What was found of the scale, if it was looked for.
    scale: Scale | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Result(Described, Savable):
    """The result of a run. Truthy when initialized.

    Attributes
    ----------
    map : InitialMap or None
        None if no map was found.
    reason : Verdict or None
        Why there is no map; None when initialized.
    frames_read : int
        Number of frames that the initializer was given.
    frames_to_init : int or None
        The same number at the moment when the map was accepted; None without a map.
    attempts : tuple of Attempt
        The last :data:`slam_init.decision.attempt_log.ATTEMPTS_KEPT`, without their matches.
    timing_ms : mapping of str to StageTimes
        Times by stage of the pipeline.
    notes : tuple of str
        Notes for the user, e.g. that the calibration was guessed.
    advice : str
        What the person who moves the camera should do about the reason; empty when initialized.
    hypotheses : tuple of InitialMap
        ``(map,)`` when initialized. Two maps if the views could not decide between them: one of the two is right, and
        the one that explains the tracks better comes first. Else empty.
    margin : Margin or None
        The last vote between two maps: how much better the first hypothesis is than the second one. None if there was
        no second one.
    scale : Scale or None
        What was found of the scale, if it was looked for. The map is in metres where it was found.
    segments : tuple of Segment
        All maps in time order, if the initializer restarted; else empty.
    camera : Camera or None
        The stated camera of the initializer.
    wrong_focal : FreeFocal or None
        The focal length by the tracks alone, where they contradict the stated one: check the calibration. A note says
        the same in words.
    method : str
        As of :attr:`slam_init.Config.method`.
    seed : int
    """

    map: InitialMap | None
    reason: Verdict | None
    frames_read: int
    frames_to_init: int | None
    attempts: tuple[Attempt, ...]
    timing_ms: Mapping[str, StageTimes]
    notes: tuple[str, ...] = ()
    advice: str = ""
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None
    scale: Scale | None = None
    segments: tuple[Segment, ...] = ()
    camera: Camera | None = None
    wrong_focal: FreeFocal | None = None
    method: str = "quest"
    seed: int = 0

    def __bool__(self) -> bool:
        return self.map is not None

    @property
    def status(self) -> str:
        """``initialized`` or ``not_initialized``."""
        return "initialized" if self.map is not None else "not_initialized"

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        return report_facts(self)


def stated_reason(verdict: Verdict, wrong_focal: FreeFocal | None) -> Verdict:
    """The reason that is stated: a calibration that the tracks contradict comes before what the frames lack.

    An unknown focal length stays, since all frames together may determine it.
    """
    return verdict if wrong_focal is None or verdict == Verdict.UNKNOWN_FOCAL_LENGTH else Verdict.WRONG_FOCAL_LENGTH


#: The name of a fact and its text.
_Facts: TypeAlias = list[tuple[str, str]]


def report_facts(result: Result, further: Sequence[tuple[str, str]] = ()) -> tuple[str, _Facts]:
    """The title and the facts (name, text) of the report of a run, as ``print`` and the command line show it.

    * ``further``: What the result does not know, as the errors against the ground truth. It stands behind the map.
    """
    if result.map is not None:
        title, facts = f"initialized after {result.frames_to_init} frames", _map_facts(result, result.map)
    else:
        assert result.reason is not None
        title = f"not initialized: {in_words(result.reason)}"
        facts = [("advice", result.advice), ("frames read", str(result.frames_read))]
        if result.hypotheses and result.margin is not None:  # both maps of an undecided pair
            frames = ", ".join(str(keyframe.frame) for keyframe in result.hypotheses[0].keyframes)
            kept = f"two maps of frames {frames}; the tracks {result.margin.in_words('the first', 'the second')}"
            facts += [("kept", kept), *_risk_facts(result)]
    verdicts = Counter(in_words(attempt.verdict) for attempt in result.attempts)
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())
    attempts = f"{len(result.attempts)}" + (f" ({counts})" if counts else "")
    notes = [("note", plain_line(note)) for note in result.notes if note != result.advice]
    return title, [*facts, *further, ("attempts", attempts), *notes]


def _risk_facts(result: Result) -> _Facts:
    """The line about the risk of the best map, where a window was evaluated, and the depths of the landmarks."""
    window = next((attempt.window for attempt in reversed(result.attempts) if attempt.window is not None), None)
    if window is None:
        return []
    depth_sigma = math.nan if result.map is None else result.map.depth_sigma
    depths = f", depths +- {depth_sigma:.1%}" if math.isfinite(depth_sigma) else ""
    model_risk = window.risk if result.map is None else result.map.model_risk or window.risk
    return [("risk", f"{risk_in_words(model_risk)}, direction +- {window.direction_sigma_deg:.1f} deg{depths}")]


def _map_facts(result: Result, map_: InitialMap) -> _Facts:
    """The lines about the map."""
    frames = ", ".join(str(keyframe.frame) for keyframe in map_.keyframes)
    facts = [("keyframes", f"{len(map_.keyframes)} (frames {frames})")]
    if len(map_.points):  # the map of an external program has none
        facts += [
            ("landmarks", f"{len(map_.points)}, {map_.scene} scene"),
            ("parallax", f"{map_.median_parallax_deg:.2f} deg (median)"),
            ("reprojection", f"{map_.reprojection_rmse_px:.2f} px (rms)"),
        ]
    facts += _risk_facts(result)
    if result.scale is not None:
        facts.append(("scale", _scale_text(result.scale, map_.depth_sigma)))
    if map_.gravity is not None:
        x, y, z = map_.gravity.down
        down = f"down is ({x:.3f}, {y:.3f}, {z:.3f}) in the world, +- {map_.gravity.sigma_deg:.1g} deg"
        facts.append(("gravity", down))
    if map_.focal_factor_sigma is not None:
        adjusted = f"{map_.focal_factor:.3f} +- {map_.focal_factor_sigma:.3f} times the stated one (adjusted)"
        estimated = f"{map_.camera.fx:.0f} +- {map_.camera.focal_sigma_px or 0.0:.0f} px, estimated from the motion"
        facts.append(("focal length", estimated if map_.camera.source == "estimated" else adjusted))
    return facts


def _scale_text(scale: Scale, depth_sigma: float) -> str:
    if scale.metres_per_unit is None or scale.sigma is None:
        return f"none found from {scale.origin}: {scale.reason}"
    # The scale is that of the baselines. A landmark is as uncertain as its own depth.
    points = f"; the depth of a landmark to +- {depth_sigma:.0%}" if depth_sigma > scale.sigma else ""
    known = f"1 unit = {scale.metres_per_unit:.4g} m +- {scale.sigma:.1%} ({scale.origin}: {scale.evidence})"
    return f"{known}{points}; all results in metres"
