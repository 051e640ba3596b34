"""Laws of what errors of the tracks gain for a translation where the camera only rotates."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import make_window

from slam_init.window.tracks import gain_of_lasting_errors, gain_of_shared_errors, gain_of_turning_errors


@pytest.fixture(scope="module")
def tracks():
    tracks = make_window("room", 1, 3, 40, noise_px=0.5).tracks
    sweep_px_s = np.broadcast_to([30.0, 40.0], (*tracks.seen.shape, 2))
    return replace(tracks, sweep_px_s=sweep_px_s, sweep_errors=np.full(3, 0.1))


def test_errors_of_the_turning_move_each_pixel_by_a_share_of_its_sweep(tracks):
    seen = tracks.seen & (tracks.anchor >= 0)
    # 0.02 s of 50 px/s, a tenth of it wrong: 0.1 px, a fifth of the noise.
    assert gain_of_turning_errors(tracks, 0.02) == pytest.approx(0.04 * seen.sum())


def test_errors_of_the_tracker_count_less_where_the_noise_is_larger(tracks):
    noisy = tracks.with_noise(5.0)
    R = np.broadcast_to(np.diag([-1.0, 1.0, -1.0]), (3, 3, 3))
    assert 1 < gain_of_lasting_errors(noisy, R) < gain_of_lasting_errors(tracks, R)
    assert gain_of_shared_errors(noisy) == pytest.approx(gain_of_shared_errors(tracks) / 100)
