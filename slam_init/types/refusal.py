"""Refusals: the verdicts with an advice each, the stages of an attempt, and the gates that it has to pass."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


# To add a reason, add a line here: the value goes to ``summary.json``, and the advice is shown to the person who moves
# the camera. A gate or a rule of ``slam_init.decision`` then names the reason: ``screening`` before two views,
# ``two_views`` for a pair (a reason of :mod:`quest` has the name of its member), ``_reason`` of ``evaluated_window``
# for a window, ``depths`` and ``window_rule`` for a map. The check of the stated focal length names the reason of a
# window that would have a map, and that of a whole run (``AttemptLog``). ``VERDICT_COLORS`` of
# ``slam_init.pictures.drawing`` gives it a colour. The page of the reasons is made from this list.
class Verdict(StrEnum):
    """The verdict on a frame: accepted, or the reason of the refusal.

    The stage of an attempt that refuses it gives the reason, and the stages decide which reason comes first. A run
    reports the most frequent reason of the second half of its attempts. Of equally frequent reasons it reports the
    first member: the special case stands before the general one (a static camera, a pure rotation, low parallax).
    A stated focal length that the tracks contradict comes before all of them but ``unknown_focal_length``.

    Attributes
    ----------
    advice : str
        What the person who moves the camera should do, in a few words; empty for ``accepted``.
    """

    advice: str

    def __new__(cls, value: str, advice: str = "") -> Verdict:
        """Make a member with an advice."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.advice = advice
        return member

    STATIC_CAMERA = "static_camera", "the camera stands still: move it sideways"
    PURE_ROTATION = "pure_rotation", "the camera only rotates: translate it, best sideways"
    LOW_PARALLAX = "low_parallax", "the views are too close together for the depth of the scene: keep translating"
    TOO_FEW_FEATURES = "too_few_features", "too few features in the image: more light, focus or texture"
    TOO_FEW_MATCHES = (
        "too_few_matches",
        "too few features are seen in both views: move more slowly, or look at more texture",
    )
    NO_CONSISTENT_MOTION = (
        "no_consistent_motion",
        "no rigid motion explains enough matches: moving objects, or a wrong calibration",
    )
    MOVING_OBJECTS = (
        "moving_objects",
        "a part of the view moves on its own, or the camera model is wrong there: look at more of the scene at rest",
    )
    AMBIGUOUS_PLANE = (
        "ambiguous_plane",
        "the scene is flat and two motions explain it: move in a curve, or show something off the plane",
    )
    UNKNOWN_FOCAL_LENGTH = (
        "unknown_focal_length",
        "the motion does not determine the focal length: turn the camera while it moves, or give --camera",
    )
    WRONG_FOCAL_LENGTH = "wrong_focal_length", "the stated focal length does not fit the tracks: check --camera"
    TOO_FEW_LANDMARKS = "too_few_landmarks", "too few points can be triangulated well: keep translating"
    BUNDLE_ADJUSTMENT_FAILED = "bundle_adjustment_failed", "bundle adjustment found no consistent map: keep moving"
    EXTERNAL_METHOD = "external_method", "the external program gave no map: its own output may state why"
    TOO_FEW_FRAMES = "too_few_frames", "a map needs two frames or more: give further ones"
    ACCEPTED = "accepted", ""


def in_words(verdict: str) -> str:
    """Write a verdict in words."""
    return verdict.replace("_", " ")


#: Every verdict but ``accepted``.
REASONS: tuple[Verdict, ...] = tuple(verdict for verdict in Verdict if verdict is not Verdict.ACCEPTED)


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

    # Stage MATCHES.
    FEATURES = "features"
    MATCHES = "matches"
    # Stage MOTION: 90th percentile of the displacement of the tracks; angle of the best rotation, in pixels at the
    # centre of the image.
    MOTION_PX = "motion_px"
    ROTATION_PX = "rotation_px"
    # Stage MAP: the probability that the best motion of the window is wrong; the relative standard deviation of a focal
    # length that is estimated; the number of landmarks of the map; the share of them whose depths are known; the
    # standard deviation of the position of the next view, over its baseline; the median parallax of the landmarks.
    RISK = "risk"
    FOCAL_SIGMA = "focal_sigma"
    LANDMARKS = "landmarks"
    KNOWN_DEPTHS = "known_depths"
    LOCATED_SIGMA = "located_sigma"
    PARALLAX_DEG = "parallax_deg"

    @property
    def unit(self) -> str:
        """Unit of the value and of the threshold; empty for shares, counts and ratios."""
        suffix = self.rpartition("_")[2]
        return suffix if suffix in ("px", "deg") else ""


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
        pair = (self.value, self.threshold)
        smaller, larger = pair if self.direction is Direction.AT_LEAST else (max(self.threshold, 0.0), self.value)
        return smaller / larger if self.value > 0 else 0.0

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
