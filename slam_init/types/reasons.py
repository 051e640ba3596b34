"""Why there is no map yet: a closed set of reasons, their precedence, what to do about each; the gates that tell."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ACCEPTED", "ADVICE", "REASONS", "Gate"]

ACCEPTED = "accepted"

#: Reason -> advice, in order of precedence. An attempt reports the first that holds: a static camera is also a pure
#: rotation (by nothing) and a pure rotation also has low parallax. A run reports what the second half of its attempts
#: mostly said, and of equals the first here.
ADVICE: dict[str, str] = {
    "static_camera": "the camera stands still: move it sideways",
    "pure_rotation": "the camera only turns: translate it, best sideways",
    "low_parallax": "the views are too close together for the depth of the scene: keep translating",
    "too_few_features": "too few features in the image: more light, focus or texture",
    "too_few_matches": "too few features are seen in both views: move more slowly, or look at more texture",
    "no_consistent_motion": "no rigid motion explains enough matches: moving objects, or a wrong calibration",
    "ambiguous_plane": "the scene is flat and two motions explain it: move in a curve, or show something off the plane",
    "too_few_landmarks": "too few points can be triangulated well: keep translating",
    "no_third_view": "no further view confirms the pair: keep moving",
    "bundle_adjustment_failed": "bundle adjustment found no consistent map: keep moving",
    "too_few_frames": "fewer than two frames were read: give a longer sequence",
}

REASONS: tuple[str, ...] = tuple(ADVICE)


@dataclass(frozen=True)
class Gate:
    """One condition. It passes when the value is at least (or at most) the threshold.

    Attributes
    ----------
    name : str
    value, threshold : float
    at_least : bool
    reason : str
        Reported when the gate does not pass.
    advice : str
        What would help then, in a few words for a person.
    """

    name: str
    value: float
    threshold: float
    at_least: bool
    reason: str
    advice: str

    def passes(self) -> bool:
        """NaN never passes."""
        return self.value >= self.threshold if self.at_least else self.value <= self.threshold

    def fulfilled(self) -> float:
        """How far the value is on its way to the threshold: 1 where it passes, else below; 0 for what is no number."""
        if self.passes():
            return 1.0
        if self.at_least:
            return self.value / self.threshold if self.value > 0 else 0.0
        return max(self.threshold, 0.0) / self.value if self.value > 0 else 0.0

    def lacking(self) -> float:
        """The factor by which a value that more parallax would lower is beyond its threshold; 1 for other gates."""
        return 1.0 if self.at_least or not self.value > 0 else self.value / self.threshold

    def evidence(self) -> dict[str, float | int | str]:
        """Value and threshold by name."""
        return {self.name: self.value, f"{self.name}_gate": self.threshold}
