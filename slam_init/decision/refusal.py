"""Refusals: an attempt with a verdict, its gates and its advice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam_init.frontend.keyframes import PairPreview
from slam_init.status import progress
from slam_init.types.reasons import ADVICE, Gate
from slam_init.types.result import Attempt

__all__ = ["Evidence", "looked_at", "preview_evidence", "refusal", "refused", "refused_at", "refused_by"]

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
