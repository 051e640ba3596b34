"""Laws of the frames that are not judged."""

from types import SimpleNamespace

import pytest

from slam_init.decision.frame_skipper import FrameSkipper


def window(views, total=1.0, sigma_deg=1.0):
    """A stand-in for a judged window."""
    risk = SimpleNamespace(total=total, directions=SimpleNamespace(sigma_deg=sigma_deg))
    return SimpleNamespace(risk=risk, best=SimpleNamespace(rows=range(views)))


def after(frames, in_vain=0):
    """A skipper after some frames, and some windows that were refused in vain."""
    skipper = FrameSkipper()
    assert not any(skipper.skips(1.0, None) for _ in range(frames))
    for _ in range(in_vain):
        skipper.judged(in_vain=True)
    return skipper


def rests(skipper, last, score=1.0):
    """The frames that are left out before the next judgement."""
    left_out = 0
    while skipper.skips(score, last):
        left_out += 1
    return left_out


@pytest.mark.parametrize(("frames", "sigma_deg", "most"), [(10, 5.0, 1), (18, 5.0, 2), (20, 90.0, 3), (97, 90.0, 10)])
def test_a_rest_lasts_for_a_tenth_of_the_frames_so_far_at_most(frames, sigma_deg, most):
    """Or for one frame after a window at even odds, and three where the direction is unknown."""
    assert rests(after(frames), window(12, sigma_deg=sigma_deg)) == most
    assert not after(frames).skips(20.0, window(12, sigma_deg=sigma_deg))


@pytest.mark.parametrize(("frames", "in_vain", "most"), [(30, 3, 0), (30, 4, 1), (30, 30, 3), (7, 9, 0), (55, 20, 5)])
def test_after_small_risks_in_a_row_that_were_refused_frames_are_left_out_up_to_a_tenth(frames, in_vain, most):
    assert rests(after(frames, in_vain), window(2)) == most


def test_a_window_that_is_not_refused_in_vain_ends_the_rests_for_such_windows():
    skipper = after(50, in_vain=12)
    skipper.judged(in_vain=False)
    assert rests(skipper, window(2)) == 0


def test_no_frame_is_left_out_before_the_first_window_and_after_one_that_is_nearly_a_map():
    assert rests(after(100), None) == 0
    assert rests(after(100), window(12, total=0.1)) == 0
