"""Laws of the errors that neighbouring tracks share."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import fitted_window

from slam_init.window.direction_term import residual_agreement, variance_by_correlation


def factor(fit, residuals):
    return variance_by_correlation(replace(fit, residuals=residuals), fit.tracks.pixels[0])


@pytest.fixture(scope="module")
def fitted():
    return fitted_window("room", 0, 4)


def test_independent_errors_have_no_factor(fitted):
    rng = np.random.default_rng(0)
    shape = (*fitted.tracks.seen.shape, 2)
    factors = [factor(fitted, rng.normal(size=shape)) for _ in range(20)]
    assert min(factors) >= 1
    assert np.mean(factors) < 1.2


def test_errors_that_all_tracks_of_a_view_share_count_as_often_as_a_track_has_neighbours(fitted):
    tracks = fitted.tracks
    everywhere = replace(tracks, seen=np.ones_like(tracks.seen), anchor=np.zeros_like(tracks.anchor))
    residuals = np.ones((*tracks.seen.shape, 2))
    assert factor(replace(fitted, tracks=everywhere), residuals) == 1 + round(0.1 * len(tracks.anchor))


def agreement(fit, residuals, of=None):
    tracks = fit.tracks
    of = np.ones(len(tracks.anchor), bool) if of is None else of
    everywhere = replace(tracks, seen=np.ones_like(tracks.seen))
    return residual_agreement(replace(fit, tracks=everywhere, residuals=residuals), of, tracks.pixels[0])


def test_tracks_on_a_moving_object_agree_and_noise_does_not(fitted):
    rng = np.random.default_rng(2)
    shape = (*fitted.tracks.seen.shape, 2)
    of_noise = [agreement(fitted, 8 * rng.normal(size=shape)) for _ in range(20)]
    assert max(of_noise) < 0.2
    moved = 8 * rng.normal(size=(shape[0], 1, 2)) + rng.normal(size=shape)
    assert agreement(fitted, moved) > 0.9
    # Two moving objects on both sides of the image move as each of them does.
    left = fitted.tracks.pixels[0, :, 0] < fitted.tracks.camera.width / 2
    two = np.where(left[:, None], moved, -moved)
    assert agreement(fitted, two) > 0.8
