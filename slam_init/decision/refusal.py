"""Refusals: functions that add gates to an attempt, or a verdict with its advice and its progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam_init.types.gates import Gate, Stage, progress
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt


def with_gates(attempt: Attempt, gates: Sequence[Gate]) -> Attempt:
    """Add gates to an attempt."""
    return replace(attempt, gates=(*attempt.gates, *gates))


def refused_by(attempt: Attempt, stage: Stage, gates: Sequence[Gate]) -> Attempt:
    """Refuse an attempt for the reason of the first gate that does not pass."""
    failed = next(gate for gate in gates if not gate.passes())
    return replace(attempt, verdict=failed.reason, advice=failed.advice, stage=stage, progress=progress(stage, gates))


def refused_at(attempt: Attempt, reason: Verdict, stage: Stage | None = None) -> Attempt:
    """Refuse an attempt for a reason that has no gate; the rules of other systems have no stages."""
    so_far = 0.0 if stage is None else progress(stage)
    return replace(attempt, verdict=reason, advice=reason.advice, stage=stage, progress=so_far)
