"""Gates: conditions that a pair or a map has to pass, in four stages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from slam_init.types.reasons import Verdict


class Stage(StrEnum):
    """The stages that a pair has to pass, in this order.

    ``matches``: enough matches. ``motion``: more motion than a rotation. ``two_views``: two views that agree on a
    motion. ``map``: a motion of all views with a small risk, and a map of it that can be used.
    """

    MATCHES = "matches"
    MOTION = "motion"
    TWO_VIEWS = "two_views"
    MAP = "map"


class Direction(StrEnum):
    """The side of its threshold on which a value passes."""

    AT_LEAST = "at_least"
    AT_MOST = "at_most"


# To add a gate, add its name and unit here, make the gate with ``at_least`` or ``at_most`` in the module of
# ``slam_init.decision`` that computes the figure, and add a field for its threshold, with the reason for the default,
# to ``slam_init.config``.
class GateName(StrEnum):
    """The name of a gate, that is, of the figure that is compared with a threshold.

    A suffix ``_px`` or ``_deg`` is the unit.
    """

    #: Unit of the value and of the threshold; empty for shares, counts and ratios.
    unit: str

    def __new__(cls, value: str, unit: str = "") -> GateName:
        """Make a member with a unit."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.unit = unit
        return member

    # Stage MATCHES.
    FEATURES = "features"
    MATCHES = "matches"
    # Stage MOTION: 90th percentile of the displacement of the tracks; angle of the best rotation, in pixels at the
    # centre of the image.
    MOTION_PX = "motion_px", "px"
    ROTATION_PX = "rotation_px", "px"
    # Stage MAP: the probability that the best motion of the window is wrong; the relative standard deviation of a focal
    # length that is estimated; the number of landmarks of the map; the share of them whose depths are known; the
    # standard deviation of the position of the next view, over its baseline; the median parallax of the landmarks.
    RISK = "risk"
    FOCAL_SIGMA = "focal_sigma"
    LANDMARKS = "landmarks"
    KNOWN_DEPTHS = "known_depths"
    LOCATED_SIGMA = "located_sigma"
    PARALLAX_DEG = "parallax_deg", "deg"


@dataclass(frozen=True)
class Gate:
    """One condition, with the figure that was compared. :func:`at_least` and :func:`at_most` make gates.

    Attributes
    ----------
    name : GateName
        Name of the figure.
    value, threshold : float
        The figure and its bound, in the unit of the gate.
    direction : Direction
        Whether the value passes from the threshold upwards or downwards.
    unit : str
        Unit of value and threshold; empty for shares, counts and ratios.
    reason : Verdict
        The verdict if the gate does not pass.
    advice : str
        What the person who moves the camera should do then, in a few words.
    """

    name: GateName
    value: float
    threshold: float
    direction: Direction
    unit: str
    reason: Verdict
    advice: str

    def passes(self) -> bool:
        """Return whether the value lies on the right side of the threshold.

        Returns
        -------
        bool
            Always False for NaN.
        """
        if self.direction is Direction.AT_LEAST:
            return self.value >= self.threshold
        return self.value <= self.threshold

    def gate_fraction(self) -> float:
        """Compute how near the value is to the threshold.

        Returns
        -------
        float
            From 0 to 1: the smaller one of value and threshold divided by the larger one; 1 if the gate passes, 0 for
            NaN.
        """
        if self.passes():
            return 1.0
        if self.direction is Direction.AT_LEAST:
            return self.value / self.threshold if self.value > 0 else 0.0
        return max(self.threshold, 0.0) / self.value if self.value > 0 else 0.0

    def __str__(self) -> str:
        sign, unit = {"at_least": ">=", "at_most": "<="}[self.direction], f" {self.unit}" if self.unit else ""
        mark = "passes" if self.passes() else f"fails ({self.reason})"
        return f"{self.name} {self.value:.4g}{unit}, needs {sign} {self.threshold:.4g}{unit}: {mark}"


def at_least(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """Make a gate that passes from the threshold upwards."""
    return Gate(name, value, threshold, Direction.AT_LEAST, name.unit, reason, advice or reason.advice)


def at_most(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """Make a gate that passes from the threshold downwards."""
    return Gate(name, value, threshold, Direction.AT_MOST, name.unit, reason, advice or reason.advice)


def progress(stage: Stage, gates: Iterable[Gate] = ()) -> float:
    """Compute the progress of a pair that was refused at a stage.

    Each of the four stages counts a quarter. Within its stage, the progress of a pair is that of the gate which is
    farthest from its threshold (:meth:`Gate.gate_fraction`).
    """
    stages = tuple(Stage)
    return (stages.index(stage) + min((gate.gate_fraction() for gate in gates), default=0.0)) / len(stages)
