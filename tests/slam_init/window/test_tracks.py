"""Laws of the choice of tracks for the joint fit."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import pair_and_further, point_source

from slam_init.window.tracks import MAX_TRACKS, gather_tracks


def views_of(points, views=5, seed=1):
    source = point_source("room", seed, points=points, views=views)
    return source.camera, pair_and_further(list(source.observations()), views)


def test_the_chosen_tracks_are_spread_over_the_image():
    camera, views = views_of(1500)
    # All tracks of the right half are dropped, except a few.
    right = views[0].track_ids[views[0].pixels[:, 0] > camera.width / 2]
    few, dropped = right[:30], right[30:]
    views = [view.at(np.flatnonzero(~np.isin(view.track_ids, dropped))) for view in views]
    chosen = gather_tracks(camera, views, 0.7)
    assert np.isin(few, chosen.track_ids).mean() > 0.8
    x, y = chosen.pixels[chosen.anchor, np.arange(MAX_TRACKS)].T
    left = x < camera.width / 2
    cells = np.histogram2d(x[left], y[left], bins=(6, 9), range=((0, camera.width / 2), (0, camera.height)))[0]
    assert cells.min() >= 1
    assert cells.max() <= cells.min() + 2


def drifting(views, covariance):
    """The views with a drift that grows by this covariance (2, 2) from frame to frame."""
    return [
        replace(view, drifts=np.broadcast_to(view.frame * covariance, (len(view.track_ids), 2, 2))) for view in views
    ]


def covariances(tracks):
    """The covariances (V, T, 2, 2) of the observations."""
    unwhitened = tracks.sigma_px[..., None, None] * np.linalg.inv(tracks.whitening)
    return unwhitened @ np.swapaxes(unwhitened, -1, -2)


def test_the_least_noise_is_that_of_a_pixel_and_of_the_drift_since_the_anchor_view():
    camera, views = views_of(60)
    step = np.array([[0.5, 0.2], [0.2, 0.3]])
    tracks = gather_tracks(camera, drifting(views, step), 0.05, 0.1)
    frames = np.array(tracks.frames)
    since = np.abs(frames[:, None] - frames[np.maximum(tracks.anchor, 0)])
    variances, axes = np.linalg.eigh(step)
    for k, i in zip(*np.nonzero(tracks.seen), strict=True):
        expected = axes @ np.diag(0.1**2 + since[k, i] * variances) @ axes.T
        np.testing.assert_allclose(covariances(tracks)[k, i], expected, rtol=1e-6, atol=1e-9)
    assert tracks.noise_px == pytest.approx(tracks.least_noise_px)
    np.testing.assert_allclose(np.linalg.eigvalsh(tracks.whitening)[..., 1], 1.0)


def test_a_blurred_corner_slides_where_the_turning_changes():
    camera, views = views_of(60)
    turns = [np.array([0.0, 0.5 * k, 0.0]) for k in range(len(views))]
    still = drifting(views, np.zeros((2, 2)))
    turning = [replace(view, turn_rad_s=turn, exposure_s=0.02) for view, turn in zip(still, turns, strict=True)]
    tracks = gather_tracks(camera, turning, 0.1, 0.1)
    np.testing.assert_allclose(gather_tracks(camera, still, 0.1, 0.1).sigma_px, 0.1)
    far = covariances(tracks)[-1][tracks.seen[-1] & (tracks.anchor == 0)]
    # Along the rows, by the share of 0.15 of the exposure.
    slide_px = 0.15 * 0.02 * np.linalg.norm(turns[-1]) * camera.fx
    assert np.median(np.sqrt(far[:, 0, 0] - 0.1**2)) == pytest.approx(slide_px, rel=0.3)
    assert np.median(far[:, 1, 1]) < 0.2 * np.median(far[:, 0, 0])
