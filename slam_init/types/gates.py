"""Gates: conditions that a pair or a map has to pass, in four stages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from slam_init.types.reasons import Verdict

__all__ = ["Direction", "Gate", "GateName", "Stage", "at_least", "at_most", "progress"]


class Stage(StrEnum):
    """The stages that a pair has to pass, in this order.

    ``matches``: enough matches. ``motion``: more motion than a rotation. ``two_views``: two views that agree on a
    motion and determine its direction. ``map``: a map that further views confirm.
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
# to ``slam_init.config``. Then run ``python tests/support/make_schema.py``.
class GateName(StrEnum):
    """The name of a gate, that is, of the figure that is compared with a threshold.

    A suffix ``_px`` or ``_deg`` is the unit.

    Attributes
    ----------
    unit : str
        Unit of the value and of the threshold; empty for shares, counts and ratios.
    """

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
    # centre of the image; share of the tracks that are displaced by more than noise after the rotation is removed.
    MOTION_PX = "motion_px", "px"
    ROTATION_PX = "rotation_px", "px"
    PARALLAX_SHARE = "parallax_share"
    # Stage TWO_VIEWS: share of the matches that the motion explains; standard deviation of the direction of the
    # translation from the noise of single tracks; bound of the direction error from correlated tracking errors; three
    # standard deviations of the direction from leaving out parts of the image (jackknife).
    INLIER_SHARE = "inlier_share"
    TWO_VIEW_DIRECTION_SIGMA_DEG = "two_view_direction_sigma_deg", "deg"
    DIRECTION_CORRELATED_DEG = "direction_correlated_deg", "deg"
    DIRECTION_JACKKNIFE_DEG = "direction_jackknife_deg", "deg"
    # Stage MAP, vote between rival maps. Each track votes by the difference of its log likelihoods in the two maps, and
    # the vote is the sum over all tracks. VOTE_Z is this sum in units of its standard deviation; its threshold is
    # Margin.z_needed (4, or 3 with the plane as a constraint). VOTE_LOG_LIKELIHOOD is the sum in nats; its threshold is
    # Margin.LOG_LIKELIHOOD_NEEDED (20).
    VOTE_Z = "vote_z"
    VOTE_LOG_LIKELIHOOD = "vote_log_likelihood", "nat"
    # Stage MAP, the adjusted map (see slam_init.decision.map_gates).
    DIRECTION_BOUND_DEG = "direction_bound_deg", "deg"
    DIRECTION_FOCAL_DEG = "direction_focal_deg", "deg"
    DIRECTION_SHIFT_DEG = "direction_shift_deg", "deg"
    DEPTH_SIGMA = "depth_sigma"
    LANDMARKS = "landmarks"
    EXPLAINED_SHARE = "explained_share"
    FURTHER_VIEWS = "further_views"
    FURTHER_AGREEMENT = "further_agreement"
    # Stage MAP, rule "window": the probability that the map is wrong.
    RISK = "risk"
    # Stage MAP, the rival hypothesis of a rotation-only camera: its residual divided by the expected one.
    ROTATION_ONLY_RESIDUAL = "rotation_only_residual"


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

    def parallax_shortfall(self) -> float:
        """Compute the required baseline divided by the current one, for a value that falls as the parallax grows.

        Returns
        -------
        float
            The value divided by the threshold. 1 for a gate whose value has to be large, and for NaN.
        """
        return 1.0 if self.direction is Direction.AT_LEAST or not self.value > 0 else self.value / self.threshold

    def __str__(self) -> str:
        sign, unit = {"at_least": ">=", "at_most": "<="}[self.direction], f" {self.unit}" if self.unit else ""
        mark = "passes" if self.passes() else f"fails ({self.reason})"
        return f"{self.name} {self.value:.4g}{unit}, needs {sign} {self.threshold:.4g}{unit}: {mark}"


def at_least(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """Make a gate that passes from the threshold upwards.

    Parameters
    ----------
    name : GateName
    value, threshold : float
        In the unit of the name.
    reason : Verdict
        The verdict if the gate does not pass.
    advice : str, optional
        By default the advice of the reason.

    Returns
    -------
    Gate
    """
    return Gate(name, value, threshold, Direction.AT_LEAST, name.unit, reason, advice or reason.advice)


def at_most(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """Make a gate that passes from the threshold downwards.

    Parameters
    ----------
    name : GateName
    value, threshold : float
        In the unit of the name.
    reason : Verdict
        The verdict if the gate does not pass.
    advice : str, optional
        By default the advice of the reason.

    Returns
    -------
    Gate
    """
    return Gate(name, value, threshold, Direction.AT_MOST, name.unit, reason, advice or reason.advice)


def progress(stage: Stage, gates: Iterable[Gate] = ()) -> float:
    """Compute the progress of a pair that was refused at a stage.

    Each of the four stages counts a quarter. Within its stage, the progress of a pair is that of the gate which is
    farthest from its threshold (:meth:`Gate.gate_fraction`).

    Parameters
    ----------
    stage : Stage
        The stage that refused the pair.
    gates : iterable of Gate
        The gates of this stage; empty if the refusal has no gate.

    Returns
    -------
    float
        From 0 to 1.
    """
    stages = tuple(Stage)
    return (stages.index(stage) + min((gate.gate_fraction() for gate in gates), default=0.0)) / len(stages)
