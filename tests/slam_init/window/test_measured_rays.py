"""The compiled start of a fit equals the readable formulas."""

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import make_window

from slam_init.window.lens_offset import IN_USE
from slam_init.window.measured_rays import measured_rays, triangulated


@pytest.mark.parametrize("k1", [0.0, 0.2])
@pytest.mark.parametrize("model", list(CAMERAS))
def test_the_rays_are_those_of_the_camera_and_missing_where_it_has_none(model, k1):
    camera = CAMERAS[model].bent(k1)
    tracks = make_window("room", 1, 4, 100, camera=CAMERAS[model]).tracks
    expected = camera.bearings(tracks.pixels.reshape(-1, 2)).reshape(*tracks.seen.shape, 3)
    found = measured_rays(camera, tracks.pixels, tracks.seen)
    np.testing.assert_allclose(found[tracks.seen], expected[tracks.seen], atol=1e-12)


def test_the_distances_are_those_of_linear_least_squares():
    window = make_window("room", 2, 4, 60, noise_px=1.0, baseline=0.2, turning=0.1)
    tracks, R, t = window.tracks, window.R, window.t
    bearings = tracks.bearings(IN_USE)
    bearings[2, 5] = np.nan
    anchor = np.maximum(tracks.anchor, 0)
    rays = tracks.rays
    found = triangulated(R, t, bearings, tracks.seen, tracks.anchor, rays)
    for i, a in enumerate(anchor):
        rows, right = [np.zeros(3)], [np.zeros(3)]
        for k in np.flatnonzero(tracks.seen[:, i]):
            if k == a or np.isnan(bearings[k, i, 0]):
                continue
            Q = R[k] @ R[a].T
            rows.append(np.cross(bearings[k, i], t[k] - Q @ t[a]))
            right.append(-np.cross(bearings[k, i], Q @ rays[i]))
        column = np.concatenate(rows)[:, None]
        expected = np.linalg.lstsq(column, np.concatenate(right), rcond=None)[0][0]
        assert found[i] == pytest.approx(max(expected, 0.0), rel=1e-6, abs=1e-9)
