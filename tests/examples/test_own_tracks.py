"""The example that feeds the initializer with its own features and matches."""

import own_tracks
import pytest

from slam_init.compare.measures import pose_errors

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def result(room):
    """The result of ORB tracks on the room."""
    return own_tracks.initialize_from_tracks(room.camera, room.frames(0, 40))


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
