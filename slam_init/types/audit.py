"""The audit of a map from anywhere."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from quest.display import Described
from slam_init.types.initial_map import risk_in_words
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict, in_words


class AuditVerdict(StrEnum):
    """The verdict on a map: ``doubtful`` where the tracks do not decide, ``wrong`` at odds of nine to one."""

    SOUND = "sound"
    DOUBTFUL = "doubtful"
    WRONG = "wrong"


@dataclass(frozen=True, eq=False, repr=False)
class Audit(Described):
    """The stated risk of a map from anywhere. Its terms add up to that of the model, to 1 at the most.

    Attributes
    ----------
    verdict : AuditVerdict
        ``sound`` if the risk by the model is at most ``Config().acceptance.max_risk`` (0.005), ``wrong`` if it is above
        0.9, else ``doubtful``.
    risk : float
        Probability that the map is wrong: a rotation off by more than 5 degrees, or the direction of a baseline by more
        than 15. The sum of :attr:`model_risk` and the rate of causes that no model has.
    model_risk : float
        The same by the model of the window.
    risk_direction : float
        Probability that the best motion is right, and a map at its fit would be wrong.
    risk_competing : float
        Probability that another motion is right, and the map is not near it.
    risk_rotation : float
        Probability that the camera only rotates.
    risk_moving : float
        Probability that the tracks that the best motion does not explain are the scene at rest.
    risk_floor : float
        Probability of what is not modelled.
    risk_map : float
        Probability that the best motion is right, and the map is wrong because it is a distance away from its fit.
    direction_sigma_deg, rotation_sigma_deg : float
        Standard deviations of the pair's direction and rotation, of the best motion.
    pair : (int, int)
        The frames whose baseline was evaluated.
    frames : tuple of int
        All frames of the window, the pair first.
    tracks : int
        Number of tracks in the window.
    rotation_deg, direction_deg : float
        Angles between the pair of the map and that of the best motion.
    better : Pose or None
        The best motion of the pair, cam2_from_cam1 with a translation of length 1, where the map is another one.
    reason : Verdict or None
        Where the doubt is about the tracks: the reason that a map of our own would be refused for.
    advice : str
        What would decide; empty for a sound map.
    notes : tuple of str
        How the poses of a file were read, where its form does not state it.
    """

    verdict: AuditVerdict
    risk: float
    model_risk: float
    risk_direction: float
    risk_competing: float
    risk_rotation: float
    risk_moving: float
    risk_floor: float
    risk_map: float
    direction_sigma_deg: float
    rotation_sigma_deg: float
    pair: tuple[int, int]
    frames: tuple[int, ...]
    tracks: int
    rotation_deg: float
    direction_deg: float
    better: Pose | None
    reason: Verdict | None
    advice: str
    notes: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.verdict is AuditVerdict.SOUND

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        names = ("direction", "competing", "rotation", "moving", "floor", "map")
        terms = ", ".join(f"{name} {getattr(self, f'risk_{name}'):.2g}" for name in names)
        reason = "" if self.reason is None else f"{in_words(self.reason)}: "
        return f"{self.verdict}: risk {risk_in_words(self.model_risk)}", [
            ("terms", terms),
            ("evaluated", f"frames {self.pair[0]} and {self.pair[1]}, {len(self.frames)} views, {self.tracks} tracks"),
            ("direction", f"{self.direction_deg:.3g} deg from the best motion, +- {self.direction_sigma_deg:.2g} deg"),
            ("rotation", f"{self.rotation_deg:.3g} deg from the best motion, +- {self.rotation_sigma_deg:.2g} deg"),
            *([("what decides", f"{reason}{self.advice}")] if self.advice else []),
            *(("note", note) for note in self.notes),
        ]
