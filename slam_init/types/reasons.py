"""Verdicts on a frame: a closed set of reasons, and an advice for each."""

from __future__ import annotations

from enum import StrEnum


# To add a reason, add a line here: the value goes to ``summary.json``, and the advice is shown to the person who moves
# the camera. A gate or a rule of ``slam_init.decision`` then names the reason: ``screening`` before two views,
# ``two_views`` for a pair (a reason of :mod:`quest` has the name of its member), ``_reason`` of ``judged_window`` for a
# window, ``depths`` and ``_map_gates`` of ``window_rule`` for a map. The check of the stated focal length names the
# reason of a whole run (``AttemptLog``). ``VERDICT_COLORS`` of
# ``slam_init.pictures.decision`` gives it a colour. The page of the reasons is made from this list.
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
    MOVING_BODIES = (
        "moving_bodies",
        "a part of the view moves on its own, or the camera model is wrong there: look at more of the scene at rest",
    )
    AMBIGUOUS_PLANE = (
        "ambiguous_plane",
        "the scene is flat and two motions explain it: move in a curve, or show something off the plane",
    )
    UNKNOWN_FOCAL_LENGTH = (
        "unknown_focal_length",
        "the motion does not tell the focal length: turn the camera while it moves, or give --camera",
    )
    WRONG_FOCAL_LENGTH = "wrong_focal_length", "the stated focal length does not fit the tracks: check --camera"
    TOO_FEW_LANDMARKS = "too_few_landmarks", "too few points can be triangulated well: keep translating"
    BUNDLE_ADJUSTMENT_FAILED = "bundle_adjustment_failed", "bundle adjustment found no consistent map: keep moving"
    EXTERNAL_METHOD = "external_method", "the external program gave no map: its own output may tell why"
    TOO_FEW_FRAMES = "too_few_frames", "a map needs two frames or more: give further ones"
    ACCEPTED = "accepted", ""


def in_words(verdict: str) -> str:
    """Write a verdict in words."""
    return verdict.replace("_", " ")


#: Every verdict but ``accepted``.
REASONS: tuple[Verdict, ...] = tuple(verdict for verdict in Verdict if verdict is not Verdict.ACCEPTED)
