"""What an attempt and a run end with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from slam_init.types.reasons import Gate

if TYPE_CHECKING:
    from slam_init.types.comparison import Margin

from slam_init.types.arrays import Bools, Floats
from slam_init.types.initial_map import InitialMap

__all__ = ["Attempt", "Result"]


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt to initialize, and what became of it.

    Attributes
    ----------
    frames : tuple of int
        Absolute indices of the pair (reference, current), then of further views that had a vote.
    verdict : str
        ``accepted`` or a reason of :data:`slam_init.types.reasons.REASONS`.
    evidence : dict
        Name -> number (or short text) that led to the verdict: each gate's value and threshold.
    advice : str
        What would help, in a few words for a person: that of the gate that failed; empty when accepted.
    pixels1, pixels2 : (N, 2) float
        The matches of the pair, raw pixels.
    inliers : (N,) bool
        Which of them the best model explains.
    gates : tuple of Gate
        The conditions that were looked at, with values and thresholds, up to the stage that failed.
    progress : float
        How far the pair came, 0 to 1: see :func:`slam_init.status.progress`.
    lacking : float
        By which factor the gates were missed that go with the inverse of the parallax: so much longer the way has to
        be. 1 where that is not what failed.
    """

    frames: tuple[int, ...]
    verdict: str
    evidence: dict[str, float | int | str]
    advice: str = ""
    pixels1: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    pixels2: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    inliers: Bools = field(default_factory=lambda: np.zeros(0, bool))
    gates: tuple[Gate, ...] = ()
    progress: float = 0.0
    lacking: float = 1.0


@dataclass(frozen=True, eq=False)
class Result:
    """What a run ends with. Truthy when initialized.

    Attributes
    ----------
    map : InitialMap or None
    reason : str or None
        None when initialized, else one of :data:`slam_init.types.reasons.REASONS`.
    frames_read : int
    frames_to_init : int or None
        Number of frames consumed, counted from the first one fed, when the map was accepted.
    attempts : tuple of Attempt
        The last :data:`slam_init.attempt_log.ATTEMPTS_KEPT`.
    timing_ms : dict
        Stage -> {"median", "p95", "total", "calls"} in milliseconds.
    notes : tuple of str
        What the user should know, e.g. that the camera was guessed.
    advice : str
        What would help, for the reason; empty when initialized.
    hypotheses : tuple of InitialMap
        The maps one of which is true: ``(map,)`` when initialized; the two that the views could not decide between,
        the better one first, while that is so; else empty.
    margin : Margin or None
        By how much the first hypothesis is better than its rival, of the last vote between two maps; None where there
        was no rival.
    """

    map: InitialMap | None
    reason: str | None
    frames_read: int
    frames_to_init: int | None
    attempts: tuple[Attempt, ...]
    timing_ms: dict[str, dict[str, float]]
    notes: tuple[str, ...] = ()
    advice: str = ""
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None

    def __bool__(self) -> bool:
        return self.map is not None

    @property
    def status(self) -> str:
        """``initialized`` or ``not_initialized``."""
        return "initialized" if self.map is not None else "not_initialized"
