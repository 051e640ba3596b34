"""Laws of static tracks: an overlay is found, slow tracks of a scene are none, a static scene is none."""

import numpy as np
import pytest

from slam_init.frontend.static_tracks import static_tracks
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations

CAMERA = Camera("pinhole", 640, 480, 457.0, 457.0, 319.5, 239.5)


def views_of(rng, points, steps, overlay=None, noise_px=0.3, missed=0.0):
    """Views of points by a camera that translates by a step a view; the tracks of the overlay stay at their pixels."""
    views = []
    for k, position in enumerate(steps):
        seen = points - position
        pixels = 457.0 * seen[:, :2] / seen[:, 2:] + [319.5, 239.5]
        if overlay is not None:
            pixels = np.where(overlay[:, None], 457.0 * points[:, :2] / points[:, 2:] + [319.5, 239.5], pixels)
        pixels = pixels + rng.normal(size=pixels.shape) * noise_px
        kept = np.flatnonzero(rng.random(len(points)) >= missed)
        views.append(Observations(k, k / 30, "", kept, pixels[kept], CAMERA.bearings(pixels[kept])))
    return views


def scene(rng, count=300):
    return np.c_[rng.uniform(-0.6, 0.6, (count, 2)), np.ones(count)] * rng.uniform(0.8, 2.0, (count, 1))


def found(views):
    return static_tracks(views[0], views[-1], views[1:-1])


@pytest.mark.parametrize(("noise_px", "missed"), [(0.1, 0.0), (0.6, 0.1)])
def test_tracks_of_an_overlay_are_found_while_the_scene_moves(noise_px, missed):
    rng = np.random.default_rng(3)
    points, overlay = scene(rng), np.arange(300) < 60
    steps = np.outer(np.arange(6), [0.02, 0.0, 0.0])
    ids = found(views_of(rng, points, steps, overlay, noise_px, missed))
    in_both = set(views_of(np.random.default_rng(3), points, steps)[0].track_ids[:60])
    assert set(ids) <= in_both
    assert len(ids) > 0.6 * 60


def test_a_camera_at_rest_has_no_overlay_and_tracks_near_the_focus_of_expansion_lie_in_the_scene():
    for seed in range(10):
        for forward in (0.0, 0.03):
            rng = np.random.default_rng(seed)
            steps = np.outer(np.arange(6), [0.0, 0.0, forward])
            assert not len(found(views_of(rng, scene(rng), steps)))


def test_a_background_of_most_of_the_tracks_is_no_overlay():
    rng = np.random.default_rng(4)
    points = scene(rng) * np.where(np.arange(300) < 200, 1000.0, 1.0)[:, None]
    assert not len(found(views_of(rng, points, np.outer(np.arange(6), [0.03, 0.0, 0.0]))))
