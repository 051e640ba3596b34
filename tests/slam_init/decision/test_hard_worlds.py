"""Worlds that once had a false map: flat ground with poles, an overlay on a drive, frames that are shifted."""

import pytest
from make_hard_worlds import drive_behind_a_logo, ground_and_poles, shifted_frames_before_a_wall

WRONG_DEG = 15.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [13, 19])
def test_points_near_a_plane_make_no_false_map(seed):
    error_deg = ground_and_poles(seed)
    assert error_deg is None or error_deg < WRONG_DEG


@pytest.mark.slow
def test_tracks_of_a_static_logo_do_not_hold_the_camera():
    error_deg = drive_behind_a_logo(3)
    assert error_deg is not None
    assert error_deg < WRONG_DEG


@pytest.mark.slow
def test_frames_that_are_shifted_as_a_whole_make_no_false_map():
    error_deg = shifted_frames_before_a_wall(20)
    assert error_deg is None or error_deg < WRONG_DEG
