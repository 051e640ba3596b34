"""Laws of the errors that neighbouring tracks share."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, fitted_window

from slam_init.window.neighbours import variance_by_neighbours


def factor(window_fit, residuals):
    tracks, fit = window_fit
    places = tracks.pixels[0]
    return variance_by_neighbours(tracks, replace(fit, residuals=residuals), PRIORS, places)


@pytest.fixture(scope="module")
def fitted():
    return fitted_window("room", 0, 4)


def test_independent_errors_have_no_factor(fitted):
    rng = np.random.default_rng(0)
    shape = (*fitted[0].seen.shape, 2)
    factors = [factor(fitted, rng.normal(size=shape)) for _ in range(20)]
    assert min(factors) >= 1
    assert np.mean(factors) < 1.2


def test_errors_that_all_tracks_of_a_view_share_count_as_often_as_a_track_has_neighbours(fitted):
    tracks, fit = fitted
    everywhere = replace(tracks, seen=np.ones_like(tracks.seen), anchor=np.zeros_like(tracks.anchor))
    residuals = np.ones((*tracks.seen.shape, 2))
    assert factor((everywhere, fit), residuals) == 1 + round(0.1 * len(tracks.anchor))


def test_outliers_have_no_part_in_it(fitted):
    rng = np.random.default_rng(1)
    residuals = rng.normal(size=(*fitted[0].seen.shape, 2))
    far = residuals.copy()
    far[:, ::2] = 50.0  # each second track, all alike
    half = residuals.copy()
    half[:, ::2] = np.inf
    assert factor(fitted, far) == factor(fitted, half) < 1.5


def test_without_tracks_there_is_no_factor(fitted):
    tracks, fit = fitted
    none = replace(tracks, anchor=np.full_like(tracks.anchor, -1))
    assert variance_by_neighbours(none, fit, PRIORS, tracks.pixels[0]) == 1.0
