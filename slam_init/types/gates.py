"""Gates: conditions that a pair or a map has to pass, in four stages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from slam_init.types.reasons import Verdict

__all__ = ["Direction", "Gate", "GateName", "Stage", "at_least", "at_most", "progress"]


class Stage(StrEnum):
    """What a pair has to pass, one after the other.

    Enough matches; a motion that is more than a rotation; two views that agree on the motion and know its direction; a
    map that further views confirm.
    """

    MATCHES = "matches"
    MOTION = "motion"
    TWO_VIEWS = "two_views"
    MAP = "map"


class Direction(StrEnum):
    """On which side of its threshold a value passes."""

    AT_LEAST = "at_least"
    AT_MOST = "at_most"


class GateName(StrEnum):
    """The gates of all stages. The value is the name in ``summary.json``.

    To add a gate: add its name and unit here, make the gate with :func:`at_least` or :func:`at_most` in the module of
    :mod:`slam_init.decision` that looks at the figure, and give its threshold a field, with the reason for its default,
    in :mod:`slam_init.config`.

    Attributes
    ----------
    unit : str
        Unit of the value and of the threshold; empty for shares, counts and ratios.
    """

    unit: str

    def __new__(cls, value: str, unit: str = "") -> GateName:
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
    # translation by the noise of single tracks; bound of its error by correlated tracking errors; three standard
    # deviations by leaving out parts of the image (jackknife).
    INLIER_SHARE = "inlier_share"
    TWO_VIEW_DIRECTION_SIGMA_DEG = "two_view_direction_sigma_deg", "deg"
    DIRECTION_CORRELATED_DEG = "direction_correlated_deg", "deg"
    DIRECTION_JACKKNIFE_DEG = "direction_jackknife_deg", "deg"
    # Stage MAP, vote between rival maps: the difference of the log likelihoods of two maps, as a sum over tracks in
    # units of the standard deviation of that sum (z), and itself in nats.
    VOTE_Z = "vote_z"
    VOTE_LOG_LIKELIHOOD = "vote_log_likelihood", "nat"
    # Stage MAP, the adjusted map.
    DIRECTION_BOUND_DEG = "direction_bound_deg", "deg"
    DIRECTION_FOCAL_DEG = "direction_focal_deg", "deg"
    DIRECTION_SHIFT_DEG = "direction_shift_deg", "deg"
    DEPTH_SIGMA = "depth_sigma"
    LANDMARKS = "landmarks"
    EXPLAINED_SHARE = "explained_share"
    FURTHER_VIEWS = "further_views"
    FURTHER_AGREEMENT = "further_agreement"
    # Stage MAP, the rival hypothesis that the camera only rotates: its residual over the expected one.
    ROTATION_ONLY_RESIDUAL = "rotation_only_residual"


@dataclass(frozen=True)
class Gate:
    """One condition, with the figure that was compared. Make one with :func:`at_least` or :func:`at_most`.

    Attributes
    ----------
    name : GateName
    value, threshold : float
        In the unit of the gate.
    direction : Direction
        Whether the value passes from the threshold upwards or downwards.
    unit : str
        Unit of value and threshold; empty for shares, counts and ratios.
    reason : Verdict
        Reported when the gate does not pass.
    advice : str
        What would help then, in a few words for a person.
    """

    name: GateName
    value: float
    threshold: float
    direction: Direction
    unit: str
    reason: Verdict
    advice: str

    def passes(self) -> bool:
        """Whether the value lies on the right side of the threshold. NaN never passes."""
        if self.direction is Direction.AT_LEAST:
            return self.value >= self.threshold
        return self.value <= self.threshold

    def gate_fraction(self) -> float:
        """How near the value is to the threshold, from 0 to 1: 1 where the gate passes, 0 for NaN."""
        if self.passes():
            return 1.0
        if self.direction is Direction.AT_LEAST:
            return self.value / self.threshold if self.value > 0 else 0.0
        return max(self.threshold, 0.0) / self.value if self.value > 0 else 0.0

    def parallax_shortfall(self) -> float:
        """Required baseline over the current one, for a value that falls as parallax grows; 1 for other gates."""
        return 1.0 if self.direction is Direction.AT_LEAST or not self.value > 0 else self.value / self.threshold

    def __str__(self) -> str:
        sign, unit = {"at_least": ">=", "at_most": "<="}[self.direction], f" {self.unit}" if self.unit else ""
        mark = "passes" if self.passes() else f"fails ({self.reason})"
        return f"{self.name} {self.value:.4g}{unit}, needs {sign} {self.threshold:.4g}{unit}: {mark}"


def at_least(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """A gate that passes from the threshold upwards.

    Parameters
    ----------
    name : GateName
    value, threshold : float
        In the unit of the name.
    reason : Verdict
        Reported when the gate does not pass.
    advice : str, optional
        By default that of the reason.

    Returns
    -------
    Gate
    """
    return Gate(name, value, threshold, Direction.AT_LEAST, name.unit, reason, advice or reason.advice)


def at_most(name: GateName, value: float, threshold: float, reason: Verdict, advice: str | None = None) -> Gate:
    """A gate that passes from the threshold downwards; parameters as :func:`at_least`.

    Parameters
    ----------
    name : GateName
    value, threshold : float
        In the unit of the name.
    reason : Verdict
        Reported when the gate does not pass.
    advice : str, optional
        By default that of the reason.

    Returns
    -------
    Gate
    """
    return Gate(name, value, threshold, Direction.AT_MOST, name.unit, reason, advice or reason.advice)


def progress(stage: Stage, gates: Iterable[Gate] = ()) -> float:
    """How far a pair came that was refused at a stage: 0 to 1, and 1 only for a map.

    Each of the four stages counts a quarter. Within its stage a pair advances by the gate that is farthest from its
    threshold.

    Parameters
    ----------
    stage : Stage
    gates : iterable of Gate
        The gates of this stage; none where the refusal has no figure.

    Returns
    -------
    float
    """
    stages = tuple(Stage)
    return (stages.index(stage) + min((gate.gate_fraction() for gate in gates), default=0.0)) / len(stages)
