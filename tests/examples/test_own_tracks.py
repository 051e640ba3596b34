"""The example that feeds the initializer with its own features and matches."""

from itertools import pairwise

import numpy as np
import own_tracks
import pytest
from make_scene import texture, window
from own_tracks import OrbTracks

from slam_init.compare.measures import pose_errors

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def result(room):
    """The result of ORB tracks on the room."""
    return own_tracks.initialize_from_tracks(room.camera, room.frames(0, 40))


def test_tracks_stay_on_their_features():
    image, tracks = texture(0, 480, 900), OrbTracks(500)
    seen = [tracks.track(window(image, 7 * k, 0, 640, 480, k).gray) for k in range(4)]
    for (ids1, pixels1), (ids2, pixels2) in pairwise(seen):
        assert (np.diff(ids2) > 0).all()
        common, i, j = np.intersect1d(ids1, ids2, return_indices=True)
        assert len(common) > 0.5 * len(ids2)
        off = np.linalg.norm(pixels2[j] - pixels1[i] + (7, 0), axis=1)
        assert np.mean(off < 2) > 0.95


def test_a_feature_that_reappears_gets_its_track_back_and_a_blank_image_has_no_features():
    image, tracks = texture(1, 480, 640), OrbTracks(300)
    before, pixels = tracks.track(image)
    hidden, _ = tracks.track(np.full((480, 640), 90, np.uint8))
    after, again = tracks.track(image)
    assert len(hidden) == 0
    common, i, j = np.intersect1d(before, after, return_indices=True)
    assert len(common) > 0.9 * len(before)
    assert np.mean(np.linalg.norm(pixels[i] - again[j], axis=1) < 1) > 0.95


def test_the_map_from_orb_tracks_is_correct(room, result):
    assert result
    errors = pose_errors(result.map, room.groundtruth)
    assert errors.rotation_deg < 5
    assert errors.direction_deg < 15


def test_the_program_prints_the_reason_if_there_is_no_map_and_reports_an_unknown_source(capsys):
    assert own_tracks.main(["synth:static?frames=4&width=320&height=240"]) == 3
    assert "static_camera" in capsys.readouterr().out
    assert own_tracks.main(["synth:nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_program_prints_that_it_initialized(result, capsys, monkeypatch):
    monkeypatch.setattr(own_tracks, "initialize_from_tracks", lambda camera, frames: result)
    assert own_tracks.main([]) == 0
    assert "initialized after" in capsys.readouterr().out
