"""Worlds that once had a false map: flat ground with poles, an overlay on a drive, frames that are shifted."""

import pytest
from make_hard_worlds import drive_behind_a_logo, ground_and_poles, shifted_frames_before_a_wall

WRONG_DEG = 15.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "seed"),
    [(ground_and_poles, 13), (ground_and_poles, 19), (shifted_frames_before_a_wall, 20), (drive_behind_a_logo, 3)],
)
def test_worlds_that_had_a_false_map_have_none(world, seed):
    error_deg = world(seed)
    assert error_deg is None or error_deg < WRONG_DEG
    assert error_deg is not None or world is not drive_behind_a_logo, "tracks of a static logo hold the camera"
