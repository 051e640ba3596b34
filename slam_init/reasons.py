"""Why there is no map yet: a closed set of reasons, their precedence, and what to do about each."""

from __future__ import annotations

__all__ = ["ACCEPTED", "ADVICE", "REASONS"]

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
