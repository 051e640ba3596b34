"""How sequences are evaluated: each bound separates correct maps from false ones."""

import pytest

from slam_init.compare.criteria import Criteria, criteria_of, group_of_scene
from slam_init.compare.measures import PoseErrors, is_correct, is_strict


@pytest.mark.parametrize(
    ("group", "rotation_deg", "direction_deg"),
    [("unknown", 5, 15), ("fr1_desk_9frames", 5, 25), ("fr1_rpy_b", 3, None), ("redkitchen_a", 5, None)],
)
def test_a_map_is_correct_within_the_bounds_of_its_sequence(group, rotation_deg, direction_deg):
    criteria = criteria_of(group)
    direction = 179.0 if direction_deg is None else direction_deg - 0.1
    assert is_correct(PoseErrors(rotation_deg - 0.1, direction), criteria)
    assert not is_correct(PoseErrors(rotation_deg + 0.1, direction), criteria)
    if direction_deg is not None:
        assert not is_correct(PoseErrors(rotation_deg - 0.1, direction_deg + 0.1), criteria)
        assert not is_correct(PoseErrors(rotation_deg - 0.1, None), criteria)  # not known counts as too large


@pytest.mark.parametrize("group", ["parrington", "V1_01_static", "synth:rotation", "points:static"])
def test_no_map_is_correct_if_the_camera_does_not_translate(group):
    criteria = criteria_of(group)
    assert criteria.no_translation
    assert criteria.expected_reason in ("pure_rotation", "static_camera")
    assert not is_correct(PoseErrors(0.0, 0.0), criteria)


def test_a_strict_map_is_correct_and_coarse_directions_do_not_matter_for_it():
    assert is_strict(PoseErrors(0.9, 4.9), Criteria())
    assert not is_strict(PoseErrors(0.9, 5.1), Criteria())
    coarse = criteria_of("fr1_desk_9frames")
    assert is_strict(PoseErrors(0.9, 20.0), coarse)
    assert not is_strict(PoseErrors(0.9, 26.0), coarse)


def test_the_group_of_a_scene_names_what_is_difficult():
    for label, group in (
        ("points:room?noise_px=2", "points:room"),
        ("points:room?readout_ms=30&focal_error=-0.1", "points:room, rolling, calibration"),
        ("points:room?readout_ms=0&moving=0.0", "points:room"),
        ("synth:handheld", "synth:handheld, turning"),
        ("synth:handheld?speed=0.05&motion_blur=0.5", "synth:handheld, blur"),
        ("points:handheld-wall?moving=0.3", "points:handheld-wall, turning, moving"),
    ):
        assert group_of_scene(label) == group
        assert criteria_of(group).no_translation == ("turning" in group)
