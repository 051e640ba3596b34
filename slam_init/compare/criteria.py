"""How each sequence is evaluated: how far its ground truth can be trusted, and within which bounds a map is correct.

==================  ===================================================================================
truth               a map is correct if every keyframe is within
==================  ===================================================================================
``sound``           5 degrees in rotation and 15 degrees in the direction of its baseline
``coarse``          5 degrees in rotation and 25 degrees in direction: the truth itself is off by up to ten
``rotations only``  the bound of its rotation; the direction is not evaluated
``none``            no bound: nothing is known about the map
==================  ===================================================================================

If the camera does not translate, every map is false, because no baseline exists. A truth of rotations only is a truth:
for a panorama it says that the camera did not translate.

A sequence is recognized by the name of its folder (:data:`SEQUENCES`), and a synthetic world by its scene. All other
sequences count as sound if they have a ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from urllib.parse import parse_qsl


class Truth(StrEnum):
    """How far the ground truth of a sequence can be trusted."""

    SOUND = "sound"
    COARSE = "coarse"
    ROTATIONS_ONLY = "rotations only"
    NONE = "none"


@dataclass(frozen=True)
class Criteria:
    """By which criteria the maps of a sequence are classified as correct or false."""

    #: How far the ground truth can be trusted.
    truth: Truth = Truth.SOUND
    #: The camera is static or only rotates, so every map is false.
    no_translation: bool = False
    #: A correct map has a smaller error of the rotation, in degrees.
    rotation_deg: float = 5.0
    #: A correct map has a smaller error of the direction of the baseline, in degrees. None if the direction is not
    #: evaluated.
    direction_deg: float | None = 15.0
    #: The reason that a method should give if it finds no map; None if no reason is expected.
    expected_reason: str | None = None
    #: Why the sequence is not evaluated by the defaults; empty otherwise.
    note: str = ""

    @property
    def rule(self) -> str:
        """Return the criteria in words, as in the column ``evaluated_by`` of ``results.csv``.

        * Returns: For example ``rotation within 5 deg, direction within 15 deg``.
        """
        if self.no_translation:
            return "every map is false"
        if self.truth is Truth.NONE:
            return "not evaluated"
        rotation = f"rotation within {self.rotation_deg:g} deg"
        return rotation if self.direction_deg is None else f"{rotation}, direction within {self.direction_deg:g} deg"


#: For sequences without ground truth.
NOT_EVALUATED = Criteria(truth=Truth.NONE, direction_deg=None)

#: Synthetic scenes whose camera does not translate.
_ONLY_TURNING = Criteria(no_translation=True, expected_reason="pure_rotation")
_SCENES = {
    "static": Criteria(no_translation=True, expected_reason="static_camera"),
    "rotation": _ONLY_TURNING,
    "pan": _ONLY_TURNING,
}

#: What options of a synthetic scene make difficult, by a word in the name of its group.
EFFECTS = {
    "rolling": ("readout_ms",),
    "moving": ("moving",),
    "blur": ("motion_blur",),
    "calibration": ("focal_error", "principal_error", "k1"),
}
#: The same word for a camera that only turns, in scenes whose camera translates by the option ``speed`` alone.
TURNING, _TRANSLATES_BY_SPEED = "turning", ("handheld", "handheld-wall")

#: Public sequences whose ground truth has limits, by the name of their folder.
SEQUENCES: dict[str, Criteria] = {
    "V1_01_static": Criteria(
        Truth.SOUND, True, expected_reason="static_camera",
        note="a drone stands on the ground; motion capture shows its vibration of 2 mm",
    ),
    # Methods accept maps at baselines of 1 to 4 cm here. Of the directions that PoseLib and MAGSAC find below 2.5 cm, a
    # half differs from the truth by 25 to 60 degrees, while both agree with each other within 1 degree.
    "redkitchen_a": Criteria(
        Truth.ROTATIONS_ONLY, direction_deg=None,
        note="depth tracking of another camera, 2.5 cm away; it does not resolve baselines of 1 to 4 cm",
    ),
    "fr1_desk_9frames": Criteria(
        Truth.COARSE, direction_deg=25.0,
        note="rolling shutter; the direction of a short baseline is off by five to ten degrees",
    ),
    "fr1_rpy_b": Criteria(
        Truth.ROTATIONS_ONLY, rotation_deg=3.0, direction_deg=None,
        note="rolling shutter; the truth is off by 1 degree and by 1 cm, and the baselines are 1 to 5 cm",
    ),
    "parrington": Criteria(
        Truth.ROTATIONS_ONLY, True, direction_deg=None, expected_reason="pure_rotation",
        note="photographs from a tripod; the camera does not translate",
    ),
}  # fmt: skip


def group_of_scene(label: str) -> str:
    """Return the group of a synthetic source: its scene, and what its options make difficult."""
    scene, _, query = label.partition("?")
    given = {name for name, value in parse_qsl(query) if value.strip("0.-")}
    effects = [effect for effect, options in EFFECTS.items() if given & set(options)]
    if scene.partition(":")[2] in _TRANSLATES_BY_SPEED and "speed" not in given:
        effects.insert(0, TURNING)
    return ", ".join([scene, *effects])


def criteria_of(group: str) -> Criteria:
    """Return the criteria by which the trials of a group are classified if there is a ground truth.

    * Returns: The defaults, except for scenes without translation and for the sequences in :data:`SEQUENCES`.
    """
    prefix, colon, scene = group.partition(":")
    if colon and prefix in ("synth", "points"):
        scene, *effects = scene.split(", ")
        return _ONLY_TURNING if TURNING in effects else _SCENES.get(scene, Criteria())
    return SEQUENCES.get(Path(group).name, Criteria())
