"""Laws of the frames that are not evaluated."""

from types import SimpleNamespace

import pytest

from slam_init.decision.window_rule import FrameSkipper


def window(views, total=1.0, sigma_deg=1.0):
    """A stand-in for an evaluated window."""
    risk = SimpleNamespace(total=total, directions=SimpleNamespace(sigma_deg=sigma_deg))
    return SimpleNamespace(risk=risk, best=SimpleNamespace(rows=range(views)))


def after(frames):
    """A skipper after some frames."""
    skipper = FrameSkipper()
    assert not any(skipper.count_and_skip(1.0, None) for _ in range(frames))
    return skipper


def left_out(skipper, last, score=1.0):
    """The frames that are left out before the next evaluation."""
    count = 0
    while skipper.count_and_skip(score, last):
        count += 1
    return count


@pytest.mark.parametrize(("frames", "sigma_deg", "most"), [(10, 5.0, 1), (18, 5.0, 2), (20, 90.0, 3), (97, 90.0, 10)])
def test_a_tenth_of_the_frames_so_far_is_left_out_at_most(frames, sigma_deg, most):
    """Or one frame after a window at even odds, and three where the direction is unknown."""
    assert left_out(after(frames), window(12, sigma_deg=sigma_deg)) == most
    assert not after(frames).count_and_skip(20.0, window(12, sigma_deg=sigma_deg))


def test_no_frame_is_left_out_before_the_first_window_and_after_one_that_is_nearly_a_map_or_has_few_views():
    assert left_out(after(100), None) == 0
    assert left_out(after(100), window(12, total=0.1)) == 0
    assert left_out(after(100), window(2, sigma_deg=90.0)) == 0
